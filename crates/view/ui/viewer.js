// The viewer: engine, display, controls and panel put together.

import { attachControls, ACTION_KEYS, HELD_HELP } from "./controls.js";
import { createDisplay } from "./display.js";
import { createMap } from "./chart_map.js";
import { createPanel, overlayText } from "./panel.js";

/** Milliseconds between two writings of the address. */
const ADDRESS_INTERVAL = 1000;

/** Starts the viewer with an engine: `send`, and `onpatch`, `onmessage`, `onopen`, `onlost` to be set. */
export function startViewer(engine) {
  const find = (id) => document.getElementById(id);
  const [canvas, overlay, hint, trouble] = ["picture", "overlay", "hint", "trouble"].map(find);
  const send = (event) => engine.send(event);
  let panel = null;
  let numbers = true;
  const download = (name, blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  const display = createDisplay(canvas, send, (blob) => download("geofan.png", blob));
  const map = createMap(find("map-box"), find("map"), find("map-text"));
  const words = createPanel(find("controls"), send, act);
  attachControls(canvas, find("pad"), send, act);

  function show(kind, split = null) {
    send({ type: "show", kind, split });
  }

  /** Does what a key or a button stands for. */
  function act(action) {
    if (!panel) return;
    const usual = panel.promise === null ? "exact" : "table";
    const other = panel.kind === "table" ? "exact" : "table";
    const actions = {
      swap: () => show(panel.promise === null ? "exact" : other),
      split: () => (panel.split ? show(panel.kind) : show("table", "exact")),
      error: () => show(panel.kind === "error" ? usual : "error"),
      flat: () => show(panel.kind === "flat" ? usual : "flat"),
      home: () => send({ type: "home" }),
      follow: () => send({ type: "follow" }),
      halt: () => send({ type: "halt" }),
      beyond: () => send({ type: "beyond", allowed: !panel.beyond }),
      darker: () => send({ type: "exposure", stops: panel.exposure - 0.5 }),
      brighter: () => send({ type: "exposure", stops: panel.exposure + 0.5 }),
      record: () => send({ type: "record", on: panel.recording === null }),
      replay: () => send({ type: "replay", text: "" }),
      capture: () => send({ type: "capture", width: canvas.width, height: canvas.height, samples: 16 }),
      overlay: () => { numbers = !numbers; update(); },
      copy: () => { writeAddress(); navigator.clipboard?.writeText(location.href); },
      help: () => find("help").showModal(),
    };
    actions[action]?.();
  }

  function update() {
    overlay.textContent = numbers ? overlayText(panel) : "";
    hint.textContent = panel.hint ?? "";
    find("stage").classList.toggle("split", panel.split !== null);
    trouble.hidden = panel.trouble === null;
    trouble.textContent = panel.trouble ?? "";
    map.update(panel);
    words.update(panel);
  }

  /** Sends what the address says, so that a copied address shows the same picture. */
  function readAddress() {
    const given = new URLSearchParams(location.hash.slice(1));
    const vector = (name) => given.get(name)?.split(",").map(Number);
    const [at, look, up] = ["at", "look", "up"].map(vector);
    if (at && look && up) send({ type: "place", at, look, up, fov: Number(given.get("fov") ?? 90) });
    if (given.has("show")) show(given.get("show"), given.get("split") || null);
    if (given.has("exposure")) send({ type: "exposure", stops: Number(given.get("exposure")) });
    if (given.has("beyond")) send({ type: "beyond", allowed: given.get("beyond") === "1" });
    for (const [name, value] of given) {
      if (name.startsWith("set.")) send({ type: "parameter", name: name.slice(4), value: Number(value) });
    }
  }

  function writeAddress() {
    if (!panel) return;
    const given = new URLSearchParams(location.hash.slice(1));
    for (const key of ["at", "look", "up"]) given.set(key, panel.pose[key].map((x) => Number(x.toPrecision(9))).join(","));
    given.set("fov", panel.pose.fov.toPrecision(6));
    given.set("show", panel.kind);
    given.set("split", panel.split ?? "");
    given.set("exposure", String(panel.exposure));
    given.set("beyond", panel.beyond ? "1" : "0");
    const hash = `#${given.toString().replaceAll("%2C", ",")}`;
    if (hash !== location.hash) location.replace(hash);
  }

  engine.onopen = () => {
    send({ type: "resize", width: canvas.width, height: canvas.height });
    readAddress();
  };
  engine.onlost = () => (hint.textContent = "the viewer is not running any more; waiting for it");
  engine.onpatch = (buffer) => display.show(buffer);
  engine.onmessage = (message) => {
    if (message.type === "recorded" && message.text) download("camera-path.toml", new Blob([message.text], { type: "application/toml" }));
    if (message.type === "broken") {
      trouble.hidden = false;
      trouble.textContent = `A worker has failed: ${message.text}. Reload the page.`;
    }
    if (message.type !== "panel") return;
    panel = message.panel;
    update();
  };
  display.fit();
  setInterval(writeAddress, ADDRESS_INTERVAL);
  fillHelp(find("keys"));
  const fold = find("fold");
  const setFold = (folded) => {
    find("panel").classList.toggle("folded", folded);
    fold.ariaExpanded = String(!folded);
  };
  fold.addEventListener("click", () => setFold(!find("panel").classList.contains("folded")));
  setFold(matchMedia("(max-width: 700px)").matches);
  canvas.focus();
  // For tests and for the curious: what is shown now.
  globalThis.geofan = { panel: () => panel, stats: display.stats, send };
}

function fillHelp(table) {
  const actions = Object.entries(ACTION_KEYS).map(([code, [, words]]) => [code.replace("Key", "").replace("Slash", "?").replace("BracketLeft", "[").replace("BracketRight", "]"), words]);
  for (const [keys, words] of [...HELD_HELP, ...actions]) {
    const row = table.insertRow();
    const kbd = document.createElement("kbd");
    kbd.textContent = keys;
    row.insertCell().append(kbd);
    row.insertCell().textContent = words;
  }
}
