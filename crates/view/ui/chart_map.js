// The picked path in the chart: seen along one of its coordinates.

import { paperOf } from "./display.js";
import { isSaving, short, shortAll } from "./panel.js";

/** Pairs of coordinates across and up. */
const PLANES = [[0, 1], [0, 2], [1, 2]];

/** Pixels from the path to the edges that have an axis, and to the other two; from an axis and its words to the edge. */
const [TO_AXIS_EDGE, TO_EDGE, AXIS, AXIS_WORDS] = [24, 9, 17, 8];

/** @typedef {import("./types").Panel} Panel */

/**
 * @param {HTMLElement} box @param {HTMLCanvasElement} canvas @param {HTMLElement} words @param {HTMLElement} closer
 * @param {import("./types").Send} send
 */
export function createMap(box, canvas, words, closer, send) {
  let plane = 0;
  /** @type {Panel | null} */
  let panel = null;
  /** What is drawn, and the path whose map was closed. */
  let [drawn, closed] = ["", ""];
  function turn() {
    plane = (plane + 1) % PLANES.length;
    draw();
  }
  canvas.addEventListener("click", turn);
  // A click leaves the focus, and with it the keys, where they are.
  canvas.addEventListener("mousedown", (event) => event.preventDefault());
  canvas.addEventListener("keydown", (event) => {
    if (event.repeat || !["Enter", "NumpadEnter", "Space"].includes(event.code)) return;
    event.preventDefault();
    turn();
  });
  closer.addEventListener("click", () => {
    closed = JSON.stringify(panel?.picked);
    box.hidden = true;
    // While something goes on, this would stop that first: then the engine keeps the path, unseen.
    if (panel && !panel.travelling && !isSaving(panel)) send({ type: "halt" });
  });

  /** Shows the path of a panel, if it has one. @param {Panel} next */
  function update(next) {
    panel = next;
    const path = JSON.stringify(panel.picked);
    if (!panel.picked) closed = "";
    box.hidden = !panel.picked || path === closed;
    const now = [path, panel.pose.at, canvas.clientWidth].join();
    if (box.hidden || drawn === now) return;
    drawn = now;
    draw();
  }

  function draw() {
    if (!panel?.picked) return;
    const { picked, pose, coordinates } = panel;
    const pair = PLANES[plane];
    const paper = paperOf(canvas);
    // As large as the map stands there, so that its words have the size of words.
    const side = canvas.clientWidth;
    const density = devicePixelRatio || 1;
    canvas.width = canvas.height = side * density;
    paper.scale(density, density);
    const points = picked.points.map((p) => pair.map((i) => p[i]));
    const camera = pair.map((i) => pose.at[i]);
    const all = [...points, camera];
    const reaches = [0, 1].map((k) => [Math.min(...all.map((p) => p[k])), Math.max(...all.map((p) => p[k]))]);
    const inside = side - TO_AXIS_EDGE - TO_EDGE;
    const scale = inside / (Math.max(...reaches.map(([low, high]) => high - low)) || 1);
    /** Pixels from the left or from below. @param {number} x @param {number} k */
    const along = (x, k) => TO_AXIS_EDGE + inside / 2 + (x - (reaches[k][0] + reaches[k][1]) / 2) * scale;
    /** @param {number[]} p */
    const at = (p) => [along(p[0], 0), side - along(p[1], 1)];
    paper.fillStyle = "#101216";
    paper.fillRect(0, 0, side, side);
    paper.strokeStyle = paper.fillStyle = "#e69f00";
    paper.lineWidth = 2;
    paper.beginPath();
    points.forEach((p, k) => {
      const [x, y] = at(p);
      if (k === 0 || picked.jumps.includes(k)) paper.moveTo(x, y);
      else paper.lineTo(x, y);
    });
    paper.stroke();
    if (points.length) {
      const [x, y] = at(points[points.length - 1]);
      paper.fillRect(x - 5, y - 5, 10, 10);
    }
    const [x, y] = at(camera);
    paper.strokeStyle = "#56b4e9";
    paper.beginPath();
    paper.arc(x, y, 5, 0, 7);
    paper.stroke();
    paper.translate(0, side);
    reaches.forEach((reach, k) => {
      drawAxis(paper, coordinates[pair[k]], reach, reach.map((x) => along(x, k)), 2 * k - 1);
      // From below the next.
      paper.rotate(-Math.PI / 2);
    });
    canvas.ariaLabel = `The picked path in the chart, ${coordinates[pair[0]]} to the right and ${coordinates[pair[1]]} up. Turn the map`;
    const where = shortAll(picked.points[picked.points.length - 1] ?? []).join(", ");
    words.textContent = `Path of length ${short(picked.length)} to ${picked.end}, at (${where}). ○ camera, ■ end; click the map, or press Enter on it, to turn it.`;
  }

  /** Shows a map that was closed: a path is picked, perhaps the same. */
  function reopen() {
    closed = "";
  }

  return { update, reopen };
}

/**
 * Draws an axis from the least to the largest value, and writes both there, with its name between them.
 * @param {CanvasRenderingContext2D} paper @param {string} name @param {number[]} reach
 * @param {number[]} places of both, in pixels @param {number} inwards 1 or -1: which way the path is from the axis
 */
function drawAxis(paper, name, reach, [from, to], inwards) {
  const [low, high] = shortAll(reach);
  const middle = (from + to) / 2;
  paper.strokeStyle = paper.fillStyle = "#f2f2ee";
  paper.lineWidth = 1;
  paper.beginPath();
  paper.moveTo(from, inwards * AXIS);
  paper.lineTo(to, inwards * AXIS);
  paper.stroke();
  paper.font = "11px system-ui";
  paper.textBaseline = "middle";
  paper.textAlign = "center";
  const write = (/** @type {string} */ text, /** @type {number} */ x) => paper.fillText(text, x, inwards * AXIS_WORDS);
  /** @param {string} text */
  const half = (text) => paper.measureText(text).width / 2;
  // A number stands where its value is, but not in the name.
  const beside = half(name) + 5;
  write(name, middle);
  write(low, Math.min(from + half(low), middle - beside - half(low)));
  write(high, Math.max(to - half(high), middle + beside + half(high)));
}
