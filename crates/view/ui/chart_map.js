// The picked path in the chart: seen along one of its coordinates.

import { paperOf } from "./display.js";

/** Pairs of coordinates across and up. */
const PLANES = [[0, 1], [0, 2], [1, 2]];

/** @typedef {import("./types").Panel} Panel */

/** @param {HTMLElement} box @param {HTMLCanvasElement} canvas @param {HTMLElement} words */
export function createMap(box, canvas, words) {
  let plane = 0;
  /** @type {{ key: string, panel: Panel } | null} */
  let known = null;
  function turn() {
    plane = (plane + 1) % PLANES.length;
    if (known) draw(known.panel);
  }
  canvas.addEventListener("click", turn);
  // A click leaves the focus, and with it the keys, where they are.
  canvas.addEventListener("mousedown", (event) => event.preventDefault());
  canvas.addEventListener("keydown", (event) => {
    if (event.repeat || !["Enter", "NumpadEnter", "Space"].includes(event.code)) return;
    event.preventDefault();
    turn();
  });

  /** Shows the path of a panel, if it has one. @param {Panel} panel */
  function update(panel) {
    box.hidden = !panel.picked;
    const now = JSON.stringify([panel.picked, panel.pose.at]);
    if (!panel.picked || known?.key === now) return;
    known = { key: now, panel };
    draw(panel);
  }

  /** @param {Panel} panel */
  function draw({ picked, pose, coordinates }) {
    if (!picked) return;
    const [i, j] = PLANES[plane];
    const paper = paperOf(canvas);
    // As large as the map stands there, so that its words have the size of words.
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const density = devicePixelRatio || 1;
    [canvas.width, canvas.height] = [width * density, height * density];
    paper.scale(density, density);
    const points = picked.points.map((p) => [p[i], p[j]]);
    const all = [...points, [pose.at[i], pose.at[j]]];
    const low = [0, 1].map((k) => Math.min(...all.map((p) => p[k])));
    const high = [0, 1].map((k) => Math.max(...all.map((p) => p[k])));
    const extent = Math.max(high[0] - low[0], high[1] - low[1]) || 1;
    const scale = (width - 40) / extent;
    const at = (/** @type {number[]} */ [x, y]) => [
      width / 2 + (x - (low[0] + high[0]) / 2) * scale,
      height / 2 - (y - (low[1] + high[1]) / 2) * scale,
    ];
    paper.fillStyle = "#101216";
    paper.fillRect(0, 0, width, height);
    paper.strokeStyle = "#e69f00";
    paper.lineWidth = 2;
    paper.beginPath();
    points.forEach((p, k) => {
      const [x, y] = at(p);
      const before = points[k - 1];
      // A jump is a glued edge of the chart.
      const jump = before && Math.hypot(p[0] - before[0], p[1] - before[1]) > extent / 2;
      if (k === 0 || jump) paper.moveTo(x, y);
      else paper.lineTo(x, y);
    });
    paper.stroke();
    mark(paper, at([pose.at[i], pose.at[j]]), "#56b4e9", false);
    if (points.length) mark(paper, at(points[points.length - 1]), "#e69f00", true);
    paper.fillStyle = "#f2f2ee";
    paper.font = "13px system-ui";
    paper.fillText(`${coordinates[i]} →`, width - 40, height - 8);
    paper.fillText(`${coordinates[j]} ↑`, 6, 16);
    canvas.ariaLabel = `The picked path in the chart, ${coordinates[i]} to the right and ${coordinates[j]} up. Turn the map`;
    const end = picked.points[picked.points.length - 1] ?? [];
    const where = end.map((x) => x.toPrecision(4)).join(", ");
    words.textContent = `Path of length ${picked.length.toPrecision(4)} to ${picked.end}, at (${where}). ○ camera, ■ end; click the map, or press Enter on it, to turn it; Escape closes it.`;
  }

  /** @param {CanvasRenderingContext2D} paper @param {number[]} place @param {string} colour @param {boolean} square */
  function mark(paper, [x, y], colour, square) {
    paper.fillStyle = colour;
    paper.beginPath();
    if (square) paper.rect(x - 5, y - 5, 10, 10);
    else paper.arc(x, y, 5, 0, 7);
    paper.fill();
  }

  return { update };
}
