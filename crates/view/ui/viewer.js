// The viewer: engine, display, controls and panel put together.

import { PARAMETER, settingsIn } from "./address.js";
import { createAsked, PATIENCE } from "./asked.js";
import { attachControls, HELP_GROUPS } from "./controls.js";
import { createDisplay } from "./display.js";
import { createMap } from "./chart_map.js";
import { createPanel, overlayText } from "./panel.js";

/** Milliseconds between two writings of the address. */
const ADDRESS_INTERVAL = 1000;

/** Samples of a pixel by path tracing that the key asks for. */
const USUAL_PASSES = 256;

/** Milliseconds for which words of the user interface itself stand there. */
const SAID = 6000;

/** Stops that a session takes, darker or brighter, and samples of a pixel at rest. */
const MOST_STOPS = 20;
const MOST_STILL = 256;

/** The number of stops that a session makes of this one. @param {number} stops */
const inStops = (stops) => Math.max(-MOST_STOPS, Math.min(MOST_STOPS, stops));

/** Finds an element of the page. @param {string} id */
export function find(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no ${id}`);
  return found;
}

/**
 * Writes a text if it is another one: screen readers read what is written again, too.
 * @param {HTMLElement} element @param {string} text
 */
function writeText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Events by which the camera is somewhere else at once. */
const MOVES = ["home", "view", "place", "look", "follow", "replay"];

/**
 * Starts the viewer with an engine, whose `onpatch`, `onmessage`, `onopen` and `onlost` are set here.
 * @param {import("./types").ViewEngine} engine
 */
export function startViewer(engine) {
  const canvas = /** @type {HTMLCanvasElement} */ (find("picture"));
  const help = /** @type {HTMLDialogElement} */ (find("help"));
  const [overlay, hint, trouble, troubleText] = ["overlay", "hint", "trouble", "trouble-text"].map(find);
  const asked = createAsked();
  /** @type {import("./types").Send} */
  const send = (event) => {
    // A place of the address that still waits would undo it.
    if (MOVES.includes(event.type)) waiting = waiting.filter((one) => !one.loaded);
    if (event.type === "pick") map.reopen();
    asked.note(event);
    engine.send(event);
    if (event.type !== "parameter") return;
    retried = true;
    // No panel may come after the one that tells that it is refused.
    setTimeout(() => { serveWaiting(); update(); }, PATIENCE + 1);
  };
  /** @type {import("./types").Panel | null} */
  let panel = null;
  let numbers = true;
  /** Words of the user interface itself, why there is no engine, and why a part of it does nothing any more. */
  let [said, lost, broken] = ["", "", ""];
  /** Words of trouble that were read and closed; a value that is refused since brings the same ones back. */
  let closed = "";
  let retried = false;
  let saying = 0;
  /** The address's settings as they were read or written last: others were put there by somebody. */
  let known = "";
  /** A panel has come since the connection was opened: before, what is known is that of an earlier one. */
  let fresh = false;
  /** What is to be done with the first, or with the first that tells the parameters that were asked for. @type {{ use: (panel: import("./types").Panel) => void, loaded: boolean }[]} */
  let waiting = [];
  /** @param {string} name @param {Blob} blob */
  const download = (name, blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  const display = createDisplay(canvas, send, (kind, blob) => download(`geofan.${kind}`, blob));
  const map = createMap(find("map-box"), /** @type {HTMLCanvasElement} */ (find("map")), find("map-text"), find("map-close"), send);
  const words = createPanel(find("controls"), send, act, say);
  const controls = attachControls(canvas, find("pad"), send, act);

  /** @typedef {import("./types").Kind} Kind */
  /** @param {Kind} kind @param {Kind | null} split */
  function show(kind, split = null) {
    send({ type: "show", kind, split });
  }

  /** Shows words for a while. @param {string} text */
  function say(text) {
    said = text;
    clearTimeout(saying);
    if (text) saying = setTimeout(() => say(""), SAID);
    showHint();
  }

  function showHint() {
    // Words of the user interface stand before the engine's and do not hide them.
    writeText(hint, lost || [said, panel?.hint].filter(Boolean).join(" · "));
  }

  function showTrouble() {
    const text = broken || (panel?.trouble ?? "");
    if (text !== closed || (retried && !asked.isLoading())) closed = "";
    retried &&= asked.isLoading();
    trouble.hidden = text === "" || text === closed;
    writeText(troubleText, text);
  }

  function closeTrouble() {
    closed = troubleText.textContent ?? "";
    showTrouble();
  }

  /** Saves the picture that is chosen. */
  function capture() {
    const picture = words.picture.chosen(canvas);
    if (picture) send({ type: "capture", ...picture });
  }

  /** Copies the address, which a browser may refuse: to pages without a secure origin, and in frames. */
  async function copyAddress() {
    const copied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
    say(copied ? "the address is copied" : "this browser does not let the page copy its address: take it from the address bar");
  }

  /** Does what a key or a button stands for. @param {string} action */
  function act(action) {
    if (!panel) return;
    say("");
    actOn(action, panel);
  }

  /** @param {string} action @param {import("./types").Panel} panel */
  function actOn(action, panel) {
    const now = asked.now(panel);
    const usual = panel.promise === null ? "exact" : "table";
    const other = now.kind === "table" ? "exact" : "table";
    /** @type {Record<string, () => void>} */
    const actions = {
      swap: () => show(panel.promise === null ? "exact" : other),
      split: () => (now.split ? show(now.kind) : show("table", "exact")),
      error: () => show(now.kind === "error" ? usual : "error"),
      flat: () => show(now.kind === "flat" ? usual : "flat"),
      paths: () => send({ type: "paths", passes: now.passes ? 0 : USUAL_PASSES }),
      home: () => send({ type: "home" }),
      follow: () => send({ type: "follow" }),
      halt: () => (trouble.hidden ? send({ type: "halt" }) : closeTrouble()),
      beyond: () => send({ type: "beyond", allowed: !now.beyond }),
      darker: () => send({ type: "exposure", stops: inStops(now.exposure - 0.5) }),
      brighter: () => send({ type: "exposure", stops: inStops(now.exposure + 0.5) }),
      record: () => send({ type: "record", on: !now.recording }),
      replay: () => send({ type: "replay", text: "" }),
      capture,
      overlay: () => { numbers = !numbers; update(); },
      copy: () => { writeAddress(); copyAddress(); },
      help: () => help.showModal(),
    };
    actions[action]?.();
  }

  function update() {
    if (!panel) return;
    writeText(overlay, numbers ? overlayText(panel) : "");
    showHint();
    find("stage").classList.toggle("split", panel.split !== null);
    showTrouble();
    map.update(panel);
    words.update(panel, asked, numbers);
  }

  /**
   * Does something with a panel: this one, or the first that the engine tells; or the first that tells the parameters that
   * were asked for, if they must be loaded before. @param {(panel: import("./types").Panel) => void} use
   */
  function withPanel(use, loaded = false) {
    waiting.push({ use, loaded });
    serveWaiting();
  }

  function serveWaiting() {
    if (!panel || !fresh) return;
    asked.settle(panel);
    for (const one of waiting.splice(0)) {
      if (one.loaded && asked.isLoading()) waiting.push(one);
      else one.use(panel);
    }
  }

  /** Says which settings of the address have been left out. @param {string[]} names */
  function tellLeftOut(names) {
    if (names.length > 0) say(`settings of the address that mean nothing here and are left out: ${names.join(", ")}`);
  }

  /** Sends what the address says, so that a copied address shows the same picture. */
  function readAddress() {
    known = location.hash;
    say("");
    waiting = waiting.filter((one) => !one.loaded);
    const { settings, parameters, wrong } = settingsIn(known);
    withPanel((panel) => {
      wrong.push(...sendParameters(panel, parameters));
      tellLeftOut(wrong);
    });
    const { at, look, up, fov, show: kind, split, sky, moving, still, paths, exposure, beyond, speed, overlay } = settings;
    const place = at && look && up && { at, look, up };
    if (place && fov && parameters.size === 0) send({ type: "place", ...place, fov });
    // With other parameters another place may be one for a camera.
    else if (place || fov) withPanel(({ pose }) => send({ type: "place", ...pose, ...place, fov: fov ?? pose.fov }), true);
    if (kind) show(kind, split);
    else if (split) withPanel((panel) => show(panel.kind, split));
    if (sky) send({ type: "sky", sky });
    if (moving !== undefined) send({ type: "resolution", share: moving });
    if (still !== undefined) send({ type: "still", samples: Math.min(MOST_STILL, still) });
    if (paths !== undefined) send({ type: "paths", passes: paths });
    if (exposure !== undefined) send({ type: "exposure", stops: inStops(exposure) });
    if (beyond !== undefined) send({ type: "beyond", allowed: beyond });
    if (speed) withPanel((panel) => send({ type: "speed", factor: speed / panel.speed }));
    numbers = overlay ?? numbers;
    words.picture.choose(settings);
    update();
  }

  /**
   * Sends the address's parameters, but for those that hold: the space is loaded again, for all who look at it. Returns
   * the names of those that the manifold does not have.
   * @param {import("./types").Panel} panel @param {Map<string, number>} given
   */
  function sendParameters(panel, given) {
    const all = asked.parameters(panel);
    for (const { name, told, asked: other } of all) {
      const value = given.get(name);
      if (value !== undefined && (value !== told || other !== undefined)) send({ type: "parameter", name, value });
    }
    const names = all.map(({ name }) => name);
    return [...given.keys()].filter((name) => !names.includes(name)).map((name) => PARAMETER + name);
  }

  /** Writes what is shown into the address, unless somebody has just put another one there, which is read first. */
  function writeAddress() {
    serveWaiting();
    if (!panel || waiting.length > 0 || location.hash !== known) return;
    const given = new URLSearchParams(location.hash.slice(1));
    const { at, look, up } = panel.pose;
    for (const [key, numbers] of Object.entries({ at, look, up })) given.set(key, numbers.map((x) => Number(x.toPrecision(9))).join(","));
    given.set("fov", panel.pose.fov.toPrecision(6));
    const kinds = asked.kinds(panel);
    for (const key of ["show", "split"]) given.delete(key);
    if (kinds) {
      given.set("show", kinds.kind);
      given.set("split", kinds.split ?? "");
    }
    given.set("exposure", String(panel.exposure));
    given.set("sky", panel.sky);
    given.set("moving", String(panel.moving_share));
    given.set("paths", String(panel.passes[1]));
    given.set("beyond", panel.beyond ? "1" : "0");
    given.set("speed", String(Number(panel.speed.toPrecision(6))));
    given.set("overlay", numbers ? "1" : "0");
    for (const [key, value] of Object.entries(words.picture.settings())) {
      if (value) given.set(key, value);
      else given.delete(key);
    }
    const still = asked.still();
    if (still === null) given.delete("still");
    else given.set("still", String(still));
    // The file's own values are left out: they would stay when the file is changed.
    for (const { name, told, asked: value, own } of asked.parameters(panel)) {
      if (own || given.has(PARAMETER + name)) given.set(PARAMETER + name, String(value ?? told));
    }
    const hash = `#${given.toString().replaceAll("%2C", ",")}`;
    // Whole, because in a frame an address is not completed by the document's own.
    if (hash !== location.hash) history.replaceState(null, "", location.href.split("#")[0] + hash);
    known = location.hash;
  }

  /** Takes an address that was put there while the viewer runs. What it asks for is told a little later. */
  function takeAddress() {
    if (location.hash === known) return;
    readAddress();
    clearInterval(writing);
    writing = setInterval(writeAddress, ADDRESS_INTERVAL);
  }

  engine.onopen = () => {
    lost = "";
    [fresh, waiting] = [false, []];
    send({ type: "resize", width: canvas.width, height: canvas.height });
    controls.tellAgain();
    // Again what was asked for while nobody was there.
    readAddress();
  };
  engine.onlost = (why) => {
    lost = why;
    showHint();
  };
  engine.onpatch = (buffer) => display.show(buffer);
  engine.onmessage = (message) => {
    if (message.type === "recorded" && message.text) download("camera-path.toml", new Blob([message.text], { type: "application/toml" }));
    if (message.type === "broken") {
      broken = `A part of the viewer has failed: ${message.text}. Reload the page.`;
      showTrouble();
    }
    if (message.type !== "panel") return;
    panel = message.panel;
    fresh = true;
    serveWaiting();
    update();
  };
  display.fit();
  let writing = setInterval(writeAddress, ADDRESS_INTERVAL);
  addEventListener("hashchange", takeAddress);
  fillHelp(/** @type {HTMLTableElement} */ (find("keys")));
  find("trouble-close").addEventListener("click", closeTrouble);
  const fold = find("fold");
  const setFold = (/** @type {boolean} */ folded) => {
    find("panel").classList.toggle("folded", folded);
    fold.ariaExpanded = String(!folded);
  };
  fold.addEventListener("click", () => setFold(!find("panel").classList.contains("folded")));
  const narrow = matchMedia("(max-width: 700px), (max-height: 480px)");
  narrow.addEventListener("change", () => setFold(narrow.matches));
  setFold(narrow.matches);
  canvas.focus();
  // For tests and for the curious: what is shown now.
  Object.assign(globalThis, { geofan: { panel: () => panel, stats: display.stats, send } });
}

/** @param {HTMLTableElement} table */
function fillHelp(table) {
  for (const [title, rows] of HELP_GROUPS) {
    const head = document.createElement("th");
    [head.colSpan, head.scope, head.textContent] = [2, "colgroup", title];
    table.createTBody().insertRow().append(head);
    for (const [keys, words] of rows) {
      const row = table.insertRow();
      const cell = row.insertCell();
      for (const key of keys.split(" ")) {
        const kbd = document.createElement("kbd");
        kbd.textContent = key;
        cell.append(kbd, " ");
      }
      row.insertCell().textContent = words;
    }
  }
}
