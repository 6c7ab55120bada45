// The panel's data in words and controls.

const KINDS = [["table", "Table"], ["exact", "Exact"], ["flat", "Flat"], ["error", "Error"]];

/** Makes an element with properties and children. */
function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** A number in four digits. */
function short(x) {
  if (x === null || x === undefined) return "–";
  return Math.abs(x) >= 1e4 || (x !== 0 && Math.abs(x) < 1e-3) ? x.toExponential(2) : Number(x.toPrecision(4)).toString();
}

/**
 * Builds the panel.
 * @param {HTMLElement} root @param {(event: object) => void} send @param {(action: string) => void} act
 */
export function createPanel(root, send, act) {
  const kinds = KINDS.map(([kind, word]) => {
    const button = make("button", { type: "button", textContent: word });
    button.addEventListener("click", () => send({ type: "show", kind, split: null }));
    return [kind, button];
  });
  const button = (word, action) => {
    const made = make("button", { type: "button", textContent: word });
    made.addEventListener("click", () => act(action));
    return made;
  };
  const split = button("Split", "split");
  const beyond = button("Beyond the table", "beyond");
  const record = button("Record", "record");
  const exposure = make("input", { type: "range", min: "-6", max: "6", step: "0.25", value: "0" });
  exposure.addEventListener("input", () => send({ type: "exposure", stops: Number(exposure.value) }));
  const exposureWord = make("span");
  const samples = make("select", {}, ...[1, 4, 16, 64].map((n) => make("option", { value: String(n), textContent: `${n} samples when still` })));
  samples.value = "16";
  samples.addEventListener("change", () => send({ type: "still", samples: Number(samples.value) }));
  const views = make("select");
  views.setAttribute("aria-label", "Views of the scene");
  views.addEventListener("change", () => {
    send(views.value ? { type: "view", name: views.value } : { type: "home" });
    views.value = "";
  });
  const way = make("input", { type: "file", accept: ".toml", ariaLabel: "Replay a camera path" });
  way.addEventListener("change", async () => {
    const [file] = way.files;
    if (file) send({ type: "replay", text: await file.text() });
    way.value = "";
  });
  const [title, speed, state, parameters] = [make("h2"), make("p"), make("p"), make("div")];
  const legend = make("div", { id: "legend" });
  const errors = make("section", {}, make("h2", { textContent: "Screen error of the table" }), make("p"), legend);
  const certificate = make("pre");
  const details = make("details", {}, make("summary", { textContent: "Certificate of the table" }), certificate);
  root.append(
    title, make("div", { className: "row" }, ...kinds.map(([, b]) => b), split),
    make("div", { className: "row" }, beyond), errors,
    make("label", { className: "wide" }, "Exposure ", exposureWord, exposure),
    make("div", { className: "row" }, views, button("Home", "home"), samples), speed, parameters,
    make("div", { className: "row" }, button("Follow path", "follow"), record, button("Replay", "replay"), way),
    make("div", { className: "row" }, button("Save picture", "capture"), button("Copy address", "copy"), button("Help", "help")),
    state, details,
  );
  let knownViews = "";
  const sliders = new Map();

  function updateParameters(list) {
    if ([...sliders.keys()].join() !== list.map(([name]) => name).join()) {
      sliders.clear();
      parameters.replaceChildren();
      for (const [name, value] of list) {
        const reach = Math.max(Math.abs(value), 0.5);
        const slider = make("input", { type: "range", min: String(value - reach), max: String(value + reach), step: "any", value: String(value) });
        const word = make("span");
        slider.addEventListener("change", () => send({ type: "parameter", name, value: Number(slider.value) }));
        slider.addEventListener("input", () => (word.textContent = short(Number(slider.value))));
        parameters.append(make("label", { className: "wide" }, `${name} `, word, slider));
        sliders.set(name, { slider, word });
      }
    }
    for (const [name, value] of list) {
      const { slider, word } = sliders.get(name);
      if (document.activeElement === slider) continue;
      slider.value = String(value);
      word.textContent = short(value);
    }
  }

  function updateErrors(panel) {
    errors.hidden = panel.kind !== "error";
    if (errors.hidden) return;
    const text = errors.querySelector("p");
    if (panel.errors) {
      const [q, share] = panel.errors;
      text.textContent = `mrad: median ${short(q.p50)}, 95 % ${short(q.p95)}, 99 % ${short(q.p99)}, largest sampled ${short(q.max)}; ${short(100 * share)} % given up and integrated`;
    }
    if (legend.childElementCount) return;
    panel.legend.forEach(([most, [r, g, b]], i) => {
      const patch = make("canvas", { width: 22, height: 16 });
      const paper = patch.getContext("2d");
      paper.fillStyle = `rgb(${r},${g},${b})`;
      paper.fillRect(0, 0, 22, 16);
      const last = i === panel.legend.length - 1;
      const word = last ? "given up: integrated" : most === null ? "more" : `up to ${short(most)} mrad`;
      legend.append(patch, make("span", { textContent: word }));
    });
  }

  /** Shows a panel. */
  function update(panel) {
    title.textContent = panel.manifold;
    for (const [kind, b] of kinds) {
      b.ariaPressed = String(panel.kind === kind);
      b.disabled = (kind === "table" || kind === "error") && panel.promise === null;
    }
    split.ariaPressed = String(panel.split !== null);
    split.disabled = panel.promise === null;
    beyond.ariaPressed = String(panel.beyond);
    beyond.disabled = panel.promise === null;
    record.textContent = panel.recording === null ? "Record" : `Stop (${panel.recording.toFixed(0)} s)`;
    record.ariaPressed = String(panel.recording !== null);
    exposureWord.textContent = `${panel.exposure >= 0 ? "+" : ""}${panel.exposure} stops`;
    if (document.activeElement !== exposure) exposure.value = String(panel.exposure);
    if (knownViews !== panel.views.join("\n")) {
      knownViews = panel.views.join("\n");
      const options = panel.views.map((name) => make("option", { value: name, textContent: name }));
      views.replaceChildren(make("option", { value: "", textContent: "Views…" }), ...options);
    }
    views.hidden = panel.views.length === 0;
    speed.textContent = `Speed ${short(panel.speed)} a second`;
    state.textContent = panel.background ?? "";
    details.hidden = panel.certificate === null;
    certificate.textContent = panel.certificate ?? "";
    updateParameters(panel.parameters);
    updateErrors(panel);
  }

  return { update };
}

/** The numbers over the picture. */
export function overlayText(panel) {
  const { size, display, samples, seconds, rate, coordinates, pose } = panel;
  const why = panel.kind === "error" ? "every error takes an exact path" : "coarser while it moves";
  const reduced = size[0] < display[0] ? ` of ${display[0]}×${display[1]}: ${why}` : "";
  const pace = rate ? `${rate.toFixed(0)} frames a second` : seconds === null ? "" : `drawn in ${(1e3 * seconds).toFixed(0)} ms`;
  const where = coordinates.map((name, k) => `${name} ${short(pose.at[k])}`).join("  ");
  const ways = { table: "table", exact: "exact paths", flat: "flat space", error: "errors" };
  const way = panel.split ? `${ways[panel.kind]} | ${ways[panel.split]}` : ways[panel.kind];
  const fallback = panel.kind === "table" && !panel.within_table ? " (outside: exact paths)" : "";
  const lines = [
    `${way}${fallback} · ${pace}`,
    `${size[0]}×${size[1]}${reduced}, ${samples} sample${samples === 1 ? "" : "s"} a pixel`,
    `${where}   scalar curvature ${short(panel.curvature)}`,
  ];
  if (panel.hover) lines.push(`under the pointer: ${panel.hover[0]}, ${short(panel.hover[1])} away`);
  return lines.join("\n");
}
