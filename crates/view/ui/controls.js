// Keys, mouse and touch to events. Keys that move or set something are taken by where they are on the keyboard
// (event.code), so that W A S D lie together on every layout; letters that name a thing by what they write (event.key).
// Nothing uses Ctrl, Alt or Meta, which belong to the browser.

/** What keys do while they are held: right, up, forwards; turn right, down; roll clockwise. @type {Record<string, number[]>} */
const HELD_KEYS = {
  KeyW: [0, 0, 1, 0, 0, 0], KeyS: [0, 0, -1, 0, 0, 0], KeyA: [-1, 0, 0, 0, 0, 0], KeyD: [1, 0, 0, 0, 0, 0],
  KeyQ: [0, -1, 0, 0, 0, 0], KeyE: [0, 1, 0, 0, 0, 0], ArrowLeft: [0, 0, 0, -1, 0, 0], ArrowRight: [0, 0, 0, 1, 0, 0],
  ArrowUp: [0, 0, 0, 0, -1, 0], ArrowDown: [0, 0, 0, 0, 1, 0], KeyZ: [0, 0, 0, 0, 0, -1], KeyC: [0, 0, 0, 0, 0, 1],
};

/** Keys that do something once, by what they write: name of the action, and words for the help. @type {Record<string, [string, string]>} */
const NAMED_KEYS = {
  x: ["swap", "Swap table and exact"], v: ["split", "Split the screen: table and exact side by side"],
  m: ["error", "Show the error of the table in mrad"], g: ["flat", "Show the same scene in flat space"],
  l: ["paths", "Trace light from surface to surface when nothing moves"], h: ["home", "Back to the start"], t: ["follow", "Fly along the picked path"],
  b: ["beyond", "Let the camera leave the table's region"], r: ["record", "Begin or end a recording of the way"],
  p: ["replay", "Replay the way"], k: ["capture", "Save a picture (PNG, or EXR: size and samples are chosen)"], o: ["overlay", "Hide or show the numbers"],
  "?": ["help", "This help"],
};

/** Those that do so by where they lie: signs, which some layouts write with several keys or not at all. @type {Record<string, string>} */
const PLACED_KEYS = { Escape: "halt", BracketLeft: "darker", BracketRight: "brighter" };

/** The help, in groups: what unites the keys of a group, then keys, between spaces, and words. @type {[string, [string, string][]][]} */
export const HELP_GROUPS = [
  ["Places on the keyboard, named as on a US keyboard; mouse and touch", [
    ["W A S D", "Move"], ["Q E", "Down, up"], ["Z C", "Roll"], ["← → ↑ ↓ Drag", "Turn"], ["Shift", "Faster"],
    ["Wheel − +", "Speed"], ["Click Enter", "Draw the path to what is there (Enter: in the middle)"], ["Pinch Comma Period", "Angle of view"],
    ["[ ]", "Darker, brighter"], ["Escape", "Close what is told of a mistake, stop a flight or a picture being saved, close the map: one after the other"],
  ]],
  ["Letters, wherever the keyboard has them", Object.entries(NAMED_KEYS).map(([name, [, words]]) => [name.toUpperCase(), words])],
];

/**
 * What a key writes that goes by that: a sign of ASCII or a Latin letter. Other alphabets go by places, as do keys that
 * write nothing yet; and the stroke, because on a US keyboard the question mark is above it.
 */
const PLAIN = /^[!-.0-~\p{Script=Latin}]$/u;

/** What a key does once, if anything. @param {KeyboardEvent} event */
function actionOf({ key, code }) {
  if (key === "?") return NAMED_KEYS[key][0];
  if (code in HELD_KEYS) return undefined;
  const name = PLAIN.test(key) ? key : code.replace("Key", "").replace("Slash", "?");
  return NAMED_KEYS[name.toLowerCase()]?.[0] ?? PLACED_KEYS[code];
}

/** Milliseconds for which a click on a button of the pad holds it. */
const CLICKED = 250;

/** What one notch of the wheel does to the logarithm of the speed. */
const NOTCH_STEP = 0.2;

/** About what browsers tell of a notch in pixels, in lines, in pages. */
const NOTCH = [100, 3, 1];

/** How far the wheel was turned: a trackpad tells many small parts of a notch. @param {WheelEvent} event */
const notchesOf = ({ deltaY, deltaMode }) => Math.max(-1, Math.min(1, deltaY / NOTCH[deltaMode]));

/** A press that moved less than this, in pixels, is a click. */
const CLICK_REACH = 5;

/**
 * Listens to a canvas and to the pad's buttons.
 * @param {HTMLCanvasElement} canvas @param {HTMLElement} pad
 * @param {import("./types").Send} send @param {(action: string) => void} act
 */
export function attachControls(canvas, pad, send, act) {
  /** @type {Set<string>} */
  const keys = new Set();
  let fast = false;
  /** What the pad's buttons do, by the pointer that holds each, or by a button that was clicked. @type {Map<number | Element, number[]>} */
  const pressed = new Map();
  let told = "";

  function tellHeld() {
    const sum = [0, 0, 0, 0, 0, 0];
    for (const held of [...pressed.values(), ...[...keys].map((key) => HELD_KEYS[key])]) held.forEach((x, i) => (sum[i] += x));
    /** @type {import("./types").ViewerEvent} */
    const event = { type: "hold", go: sum.slice(0, 3), turn: sum.slice(3, 5), roll: sum[5], fast };
    const text = JSON.stringify(event);
    if (text !== told) send(event);
    told = text;
  }

  function release() {
    keys.clear();
    pressed.clear();
    fast = false;
    tellHeld();
  }

  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || isFor(event.target, event.code)) return;
    fast = event.shiftKey;
    const action = actionOf(event);
    if (action) { if (!event.repeat) act(action); }
    else if (event.code in HELD_KEYS) keys.add(event.code);
    else if (event.code === "Minus" || event.code === "NumpadSubtract") send({ type: "speed", factor: 0.8 });
    else if (event.code === "Equal" || event.code === "NumpadAdd") send({ type: "speed", factor: 1.25 });
    else if (event.code === "Comma") send({ type: "zoom", factor: 0.95 });
    else if (event.code === "Period") send({ type: "zoom", factor: 1.05 });
    else if (event.code === "Enter") send({ type: "pick", x: 0.5, y: 0.5 });
    else if (!event.code.startsWith("Shift")) return;
    if (event.code !== "Escape") event.preventDefault();
    tellHeld();
  });
  addEventListener("keyup", (event) => {
    // While Meta is held macOS tells of no other key that is let go.
    if (event.key === "Meta") keys.clear();
    keys.delete(event.code);
    fast = event.shiftKey;
    tellHeld();
  });
  addEventListener("blur", release);
  blurChosen();
  document.addEventListener("visibilitychange", () => document.hidden && release());

  canvas.addEventListener("wheel", (event) => {
    // With Ctrl it is the browser's, whose page gets larger.
    if (event.ctrlKey) return;
    event.preventDefault();
    send({ type: "speed", factor: Math.exp(-NOTCH_STEP * notchesOf(event)) });
  }, { passive: false });
  attachPointers(canvas, send);

  for (const button of pad.querySelectorAll("button")) {
    const { speed, go: held } = button.dataset;
    if (speed) {
      button.addEventListener("click", () => send({ type: "speed", factor: Number(speed) }));
      continue;
    }
    // As many numbers as it takes, in the order of the keys'.
    const go = (held ?? "").split(",").map(Number);
    const lift = (/** @type {PointerEvent} */ event) => { if (pressed.delete(event.pointerId)) tellHeld(); };
    let since = 0;
    let clicked = 0;
    button.addEventListener("pointerdown", (event) => {
      event.preventDefault();
      since = performance.now();
      pressed.set(event.pointerId, go);
      tellHeld();
    });
    button.addEventListener("pointerup", lift);
    button.addEventListener("pointercancel", lift);
    button.addEventListener("pointerleave", lift);
    // Keyboards and screen readers click without holding.
    button.addEventListener("click", (event) => {
      if (event.detail !== 0 && performance.now() - since > CLICKED) return;
      pressed.set(button, go);
      tellHeld();
      clearTimeout(clicked);
      clicked = setTimeout(() => { if (pressed.delete(button)) tellHeld(); }, CLICKED);
    });
  }

  /** Tells what is held to an engine that knows nothing yet. */
  function tellAgain() {
    told = "";
    tellHeld();
  }
  return { tellAgain };
}

/** Keys that a button, a link, the map or a slider answers itself. */
const OF_BUTTONS = ["Space", "Enter", "NumpadEnter", "Tab", "ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", "Home", "End"];

/**
 * Tells whether a key is for the element that has the focus, and not for the camera. Escape gives the focus back.
 * @param {EventTarget | null} target @param {string} code */
function isFor(target, code) {
  if (!(target instanceof HTMLElement)) return false;
  if (target.closest("dialog")) return true;
  const pressed = target.closest("a, button, [role=button], summary, input[type=range], input[type=checkbox], input[type=file]");
  const written = !pressed && target.closest("input, select, textarea");
  if ((pressed || written) && code === "Escape") target.blur();
  return Boolean(written) || Boolean(pressed && OF_BUTTONS.includes(code));
}

/** Gives the focus back when something was chosen from a list by a pointer, or a file. */
function blurChosen() {
  let byPointer = false;
  addEventListener("pointerdown", () => { byPointer = true; }, true);
  addEventListener("keydown", () => { byPointer = false; }, true);
  addEventListener("change", (event) => {
    const { target } = event;
    const chosen = byPointer && target instanceof HTMLSelectElement;
    if (chosen || (target instanceof HTMLInputElement && target.type === "file")) target.blur();
  });
}

/**
 * Drags turn, clicks pick, two fingers change the angle of view, and a resting pointer asks what it is on.
 * @param {HTMLCanvasElement} canvas @param {import("./types").Send} send */
function attachPointers(canvas, send) {
  /** @type {Map<number, { x: number, y: number }>} */
  const down = new Map();
  let moved = 0;
  let spread = 0;
  /** Fingers of which one was not alone are no click, however still they are. */
  let several = false;
  const share = (/** @type {PointerEvent} */ event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  };
  const apart = () => {
    const [a, b] = [...down.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener("pointerdown", (event) => {
    // The other buttons of a mouse are the browser's.
    if (event.button !== 0) return;
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (down.size === 1) moved = 0;
    several = down.size > 1;
    if (down.size === 2) spread = apart();
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = down.get(event.pointerId);
    if (!last) {
      const [x, y] = share(event);
      send({ type: "hover", x, y });
      return;
    }
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    moved += Math.abs(dx) + Math.abs(dy);
    down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (down.size === 2) {
      const now = apart();
      if (now > 0 && spread > 0) send({ type: "zoom", factor: spread / now });
      spread = now;
    } else if (moved >= CLICK_REACH) {
      const width = canvas.clientWidth;
      // The picture is dragged: what was under the pointer stays there.
      send({ type: "look", right: -dx / width, down: -dy / width });
    }
  });
  canvas.addEventListener("pointerleave", () => send({ type: "hover", x: -1, y: -1 }));
  const lift = (/** @type {PointerEvent} */ event) => {
    if (!down.delete(event.pointerId) || down.size > 0) return;
    const [x, y] = share(event);
    if (event.type === "pointerup" && moved < CLICK_REACH && !several) send({ type: "pick", x, y });
    // A drag has left behind what was under the pointer where it began.
    else if (event.pointerType === "mouse") send({ type: "hover", x, y });
  };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
}
