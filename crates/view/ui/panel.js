// The panel's data in words and controls.

import { paperOf } from "./display.js";

/** @typedef {import("./types").Panel} Panel */
/** @typedef {ReturnType<typeof import("./asked.js").createAsked>} Asked */

/** @type {[import("./types").Kind, string][]} */
export const KINDS = [["table", "Table"], ["exact", "Exact"], ["flat", "Flat"], ["error", "Error"]];

/** @type {[import("./types").Sky, string][]} */
export const SKIES = [["scene", "Skies of the scene"], ["grid", "Lettered grid"], ["stars", "Stars"]];

/** Shares of the display's sides that moving pictures can have; 0: as the machine can. */
const SHARES = [0, 1, 0.5, 0.25];

/** Samples of a pixel by path tracing that can be chosen. */
const PASSES = [0, 16, 64, 256, 1024];

/**
 * Makes an element with properties and children.
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag @param {Partial<HTMLElementTagNameMap[Tag]>} properties @param {(Node | string)[]} children
 * @returns {HTMLElementTagNameMap[Tag]}
 */
function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** Most columns or rows of a saved picture, and most pixels: more is refused. */
export const MOST_SIDE = 8192;
const MOST_SAVED = 2 ** 24;

/** Samples of a saved picture that can be chosen. */
export const SAVED_SAMPLES = [1, 16, 64, 256];

/** Most bytes of a message that the program takes. */
const MOST_SENT = 4 << 20;

/** Bytes of a message besides the text that it carries, with room to spare. */
const AROUND_TEXT = 100;

/** A number in four digits. @param {number | null | undefined} x */
export function short(x) {
  if (x === null || x === undefined) return "–";
  return Math.abs(x) >= 1e4 || (x !== 0 && Math.abs(x) < 1e-3) ? x.toExponential(2) : Number(x.toPrecision(4)).toString();
}

/** Coordinates in four digits; what only rounding keeps from being zero is zero. @param {number[]} place */
export function shortAll(place) {
  const least = 1e-12 * Math.max(1, ...place.map(Math.abs));
  return place.map((x) => short(Math.abs(x) < least ? 0 : x));
}

/** Tells whether a picture is being saved: its progress comes first in what goes on behind. @param {Panel} panel */
export const isSaving = ({ background }) => background?.startsWith("saving a picture") ?? false;

/** A number of samples, in words. @param {number} n */
const inSamples = (n) => `${n} sample${n === 1 ? "" : "s"}`;

/** The same of still pictures. @param {number} n */
const whenStill = (n) => `${inSamples(n)} when still`;

/** The same of path tracing. @param {number} n */
const byPaths = (n) => (n ? `Path tracing, ${inSamples(n)}` : "No path tracing");

/** A share of the display's sides, in words. @param {number} share */
const whileMoving = (share) => (share ? `${short(100 * share)} % while it moves` : "As sharp as it can move");

/** Chooses a value in a list that is not being used; the list gets it where it lacks it. @param {HTMLSelectElement} list @param {number} value @param {(value: number) => string} words */
function chooseIn(list, value, words) {
  if (document.activeElement === list) return;
  const text = String(value);
  if (![...list.options].some((option) => option.value === text)) list.append(numberOption(value, words));
  list.value = text;
}

/** @param {number} value @param {(value: number) => string} words */
const numberOption = (value, words) => make("option", { value: String(value), textContent: words(value) });

/** Moves a slider, which reaches farther where the value does. @param {HTMLInputElement} slider @param {number} value */
function slideTo(slider, value) {
  if (value < Number(slider.min)) slider.min = String(Math.floor(value));
  if (value > Number(slider.max)) slider.max = String(Math.ceil(value));
  slider.value = String(value);
}

/** Reads a camera path; null if it is too long for a message. @param {File} file */
async function wayOf(file) {
  if (file.size > MOST_SENT) return null;
  const text = await file.text();
  return new Blob([JSON.stringify(text)]).size + AROUND_TEXT > MOST_SENT ? null : text;
}

/**
 * Builds the panel.
 * @param {HTMLElement} root @param {import("./types").Send} send @param {(action: string) => void} act
 * @param {import("./types").Say} say
 */
export function createPanel(root, send, act, say) {
  const kinds = KINDS.map(([kind, word]) => {
    const made = make("button", { type: "button", textContent: word });
    made.addEventListener("click", () => send({ type: "show", kind, split: null }));
    return { kind, made };
  });
  /** @param {string} word @param {string} action */
  const button = (word, action) => {
    const made = make("button", { type: "button", textContent: word });
    made.addEventListener("click", () => act(action));
    return made;
  };
  const split = button("Split", "split");
  const beyond = button("Beyond the table", "beyond");
  const overlay = button("Numbers", "overlay");
  /** What needs a table. */
  const ofTable = [kinds[0].made, kinds[3].made, split, beyond];
  const record = button("Record", "record");
  const exposure = make("input", { type: "range", min: "-6", max: "6", step: "0.25", value: "0" });
  exposure.addEventListener("input", () => send({ type: "exposure", stops: Number(exposure.value) }));
  const exposureWord = make("span");
  const samples = make("select", { ariaLabel: "Samples when still" }, ...[1, 4, 16, 64].map((n) => numberOption(n, whenStill)));
  samples.value = "16";
  samples.addEventListener("change", () => send({ type: "still", samples: Number(samples.value) }));
  const moving = make("select", { ariaLabel: "Resolution while it moves" }, ...SHARES.map((n) => numberOption(n, whileMoving)));
  moving.addEventListener("change", () => send({ type: "resolution", share: Number(moving.value) }));
  const paths = make("select", { ariaLabel: "Path tracing" }, ...PASSES.map((n) => numberOption(n, byPaths)));
  paths.addEventListener("change", () => send({ type: "paths", passes: Number(paths.value) }));
  const sky = make("select", { ariaLabel: "Skies" }, ...SKIES.map(([value, textContent]) => make("option", { value, textContent })));
  sky.addEventListener("change", () => send({ type: "sky", sky: SKIES[sky.selectedIndex][0] }));
  const views = make("select");
  views.setAttribute("aria-label", "Views of the scene");
  views.addEventListener("change", () => {
    send(views.value ? { type: "view", name: views.value } : { type: "home" });
  });
  // Until then arrow keys step on from the view that was chosen; after it the same one can be chosen again.
  views.addEventListener("blur", () => { views.value = ""; });
  const way = make("input", { type: "file", accept: ".toml" });
  way.addEventListener("change", async () => {
    const file = way.files?.[0];
    const text = file && await wayOf(file);
    way.value = "";
    if (!file) return;
    if (text) send({ type: "replay", text });
    // An empty text would stand for the last recording.
    const wrong = text === "" ? "is empty" : `is too long for a camera path: it has more than ${MOST_SENT >> 20} MiB`;
    say(text ? "" : `${file.name} ${wrong}`);
  });
  const [title, speed, state, parameters, noTable] = [make("h2"), make("p"), make("p"), make("div"), make("p", { className: "small" })];
  const cancel = make("button", { type: "button", textContent: "Cancel saving" });
  cancel.addEventListener("click", () => send({ type: "halt" }));
  const reset = make("button", { type: "button", textContent: "As in the file", title: "All parameters as they were given" });
  reset.addEventListener("click", () => {
    for (const [name, value] of changed) send({ type: "parameter", name, value });
  });
  const quantiles = make("p");
  const legend = make("div", { id: "legend" });
  const errors = make("section", {}, make("h2", { textContent: "Screen error of the table" }), quantiles, legend);
  const certificate = make("pre");
  const certificateLink = make("a", { textContent: "Certificate as a file", download: "certificate.txt" });
  const details = make("details", {}, make("summary", { textContent: "Certificate of the table" }), certificate, certificateLink);
  const picture = pictureChoice(say);
  root.append(
    title, make("div", { className: "row" }, ...kinds.map(({ made }) => made), split),
    make("div", { className: "row" }, beyond, overlay), noTable, errors,
    make("label", { className: "wide" }, "Exposure ", exposureWord, exposure), make("div", { className: "row" }, sky, paths, moving),
    make("div", { className: "row" }, views, button("Home", "home"), samples), speed, parameters, reset,
    make("div", { className: "row" }, button("Follow path", "follow"), record, button("Replay", "replay")),
    make("label", { className: "wide" }, "Replay a camera path (TOML) ", way),
    make("div", { className: "row" }, button("Save picture", "capture"), button("Copy address", "copy"), button("Help", "help")),
    make("div", { className: "row" }, state, cancel), picture.element, details,
  );
  let knownViews = "";
  /** @type {Map<string, { slider: HTMLInputElement, word: HTMLElement }>} */
  const sliders = new Map();
  /** The slider that is being dragged: its value is sent when it is let go. @type {HTMLInputElement | null} */
  let dragged = null;
  /** Parameters that are others than was given, and what was. @type {[string, number][]} */
  let changed = [];

  /** Shows the parameters as they are asked for; one that is refused goes back. @param {Panel} panel @param {Asked} asked */
  function updateParameters(panel, asked) {
    const list = panel.parameters;
    if ([...sliders.keys()].join() !== list.map(([name]) => name).join()) {
      sliders.clear();
      parameters.replaceChildren();
      for (const [name, value] of list) {
        const reach = Math.max(Math.abs(value), 0.5);
        const slider = make("input", { type: "range", min: String(value - reach), max: String(value + reach), step: "any", value: String(value) });
        const word = make("span");
        slider.addEventListener("change", () => {
          dragged = null;
          send({ type: "parameter", name, value: Number(slider.value) });
        });
        slider.addEventListener("input", () => {
          dragged = slider;
          word.textContent = short(Number(slider.value));
        });
        slider.addEventListener("blur", () => { dragged = null; });
        parameters.append(make("label", { className: "wide" }, `${name} `, word, slider));
        sliders.set(name, { slider, word });
      }
    }
    changed = [];
    for (const { name, told, asked: wanted, given } of asked.parameters(panel)) {
      const made = sliders.get(name);
      const value = wanted ?? told;
      if (given !== undefined && given !== value) changed.push([name, given]);
      if (!made || made.slider === dragged) continue;
      slideTo(made.slider, value);
      made.word.textContent = short(value);
    }
    reset.hidden = changed.length === 0;
  }

  /** @param {Panel} panel */
  function updateErrors(panel) {
    errors.hidden = panel.kind !== "error";
    if (errors.hidden) return;
    if (panel.errors) {
      const [q, share] = panel.errors;
      quantiles.textContent = `mrad: median ${short(q.p50)}, 95 % ${short(q.p95)}, 99 % ${short(q.p99)}, largest sampled ${short(q.max)}; ${short(100 * share)} % given up and integrated`;
    }
    if (legend.childElementCount) return;
    panel.legend.forEach(([most, [r, g, b]], i) => {
      const patch = make("canvas", { width: 22, height: 16 });
      const paper = paperOf(patch);
      paper.fillStyle = `rgb(${r},${g},${b})`;
      paper.fillRect(0, 0, 22, 16);
      const last = i === panel.legend.length - 1;
      const word = last ? "given up: integrated" : most === null ? "more" : `up to ${short(most)} mrad`;
      legend.append(patch, make("span", { textContent: word }));
    });
  }

  /** Shows a panel, what is asked for, and whether the numbers are shown. @param {Panel} panel @param {Asked} asked @param {boolean} numbers */
  function update(panel, asked, numbers) {
    title.textContent = panel.manifold;
    for (const { kind, made } of kinds) made.ariaPressed = String(panel.kind === kind);
    split.ariaPressed = String(panel.split !== null);
    beyond.ariaPressed = String(panel.beyond);
    const why = panel.promise === null ? (panel.no_table ?? "") : "";
    for (const made of ofTable) {
      made.disabled = panel.promise === null;
      made.title = why;
    }
    noTable.textContent = why;
    noTable.hidden = why === "";
    overlay.ariaPressed = String(numbers);
    record.textContent = panel.recording === null ? "Record" : `Stop (${panel.recording.toFixed(0)} s)`;
    record.ariaPressed = String(panel.recording !== null);
    exposureWord.textContent = `${panel.exposure >= 0 ? "+" : ""}${panel.exposure} stops`;
    if (document.activeElement !== sky) sky.value = panel.sky;
    chooseIn(moving, panel.moving_share, whileMoving);
    chooseIn(paths, panel.passes[1], byPaths);
    // What is asked for is where a drag has come to, too.
    slideTo(exposure, asked.now(panel).exposure);
    const still = asked.still();
    if (still !== null) chooseIn(samples, still, whenStill);
    if (knownViews !== panel.views.join("\n")) {
      knownViews = panel.views.join("\n");
      const options = panel.views.map((name) => make("option", { value: name, textContent: name }));
      views.replaceChildren(make("option", { value: "", textContent: "Views…" }), ...options);
    }
    views.hidden = panel.views.length === 0;
    speed.textContent = `Speed ${short(panel.speed)} a second`;
    state.textContent = panel.background ?? "";
    cancel.hidden = !isSaving(panel);
    details.hidden = panel.certificate === null;
    if (certificate.textContent !== (panel.certificate ?? "")) {
      certificate.textContent = panel.certificate ?? "";
      URL.revokeObjectURL(certificateLink.href);
      certificateLink.href = URL.createObjectURL(new Blob([certificate.textContent], { type: "text/plain" }));
    }
    updateParameters(panel, asked);
    updateErrors(panel);
  }

  return { update, picture };
}

/** Controls for the picture that is saved: its size, its samples, its format. @param {import("./types").Say} say */
function pictureChoice(say) {
  const [width, height] = ["Width", "Height"].map((word) => make("input", { type: "number", min: "1", max: String(MOST_SIDE), placeholder: word.toLowerCase(), ariaLabel: `${word} of the saved picture` }));
  const samples = make("select", { ariaLabel: "Samples of the saved picture" }, ...SAVED_SAMPLES.map((n) => make("option", { value: String(n), textContent: inSamples(n) })));
  samples.value = "16";
  const format = make("select", { ariaLabel: "Format of the saved picture" }, ...["PNG", "EXR"].map((value) => make("option", { value, textContent: value })));
  const row = make("div", { className: "row" }, width, "×", height, samples, format);
  const element = make("details", {}, make("summary", { textContent: "Picture to save" }), row);
  /** A side; the display's where nothing is written. @param {HTMLInputElement} field @param {number} usual */
  const side = ({ value, validity, valueAsNumber }, usual) => (value === "" && !validity.badInput ? usual : valueAsNumber);

  /** What is chosen; null, in words, if it is no picture. @param {HTMLCanvasElement} canvas */
  function chosen(canvas) {
    const sides = [side(width, canvas.width), side(height, canvas.height)];
    if (!sides.every((n) => Number.isInteger(n) && n >= 1 && n <= MOST_SIDE)) {
      say(`width and height of a saved picture are whole numbers from 1 to ${MOST_SIDE}`);
      return null;
    }
    if (sides[0] * sides[1] > MOST_SAVED) {
      say(`a saved picture has at most ${MOST_SAVED} pixels: ${sides.join("×")} are ${sides[0] * sides[1]}`);
      return null;
    }
    return { width: sides[0], height: sides[1], samples: Number(samples.value), light: format.value === "EXR" };
  }

  /** What is written into the address; nothing for a side that is the display's, or none. */
  const settings = () => ({
    "save.width": width.validity.valid ? width.value : "", "save.height": height.validity.valid ? height.value : "",
    "save.samples": samples.value, "save.format": format.value.toLowerCase(),
  });

  /** Takes what the address says. @param {import("./types").Settings} given */
  function choose(given) {
    width.value = String(given["save.width"] ?? width.value);
    height.value = String(given["save.height"] ?? height.value);
    samples.value = String(given["save.samples"] ?? samples.value);
    format.value = given["save.format"]?.toUpperCase() ?? format.value;
  }
  return { element, chosen, settings, choose };
}

/** The numbers over the picture. @param {Panel} panel */
export function overlayText(panel) {
  const { size, display, samples, passes, seconds, rate, coordinates, pose } = panel;
  const why = panel.kind === "error" ? "every error takes an exact path" : "coarser while it moves";
  const reduced = size[0] < display[0] ? ` of ${display[0]}×${display[1]}: ${why}` : "";
  const pace = rate ? `${rate.toFixed(0)} frames a second` : seconds === null ? "" : `drawn in ${(1e3 * seconds).toFixed(0)} ms`;
  const place = shortAll(pose.at);
  const where = coordinates.map((name, k) => `${name} ${place[k]}`).join("  ");
  const ways = { table: "table", exact: "exact paths", flat: "flat space", error: "errors" };
  const way = panel.split ? `${ways[panel.kind]} | ${ways[panel.split]}` : ways[panel.kind];
  const outside = ["table", "error"].includes(panel.kind) && !panel.within_table;
  const fallback = outside ? " (outside: exact paths)" : panel.decoding ? " (being decoded here: exact paths until then)" : "";
  const traced = passes[0] > 0 ? `, ${passes[0]} of ${passes[1]} by path tracing` : "";
  const lines = [
    `${way}${fallback} · ${pace}`,
    `${size[0]}×${size[1]}${reduced}, ${inSamples(samples)} a pixel${traced}`,
    `${where}   scalar curvature ${short(panel.curvature)}   speed ${short(panel.speed)}`,
  ];
  if (panel.hover) lines.push(`under the pointer: ${panel.hover[0]}, ${short(panel.hover[1])} away`);
  return lines.join("\n");
}
