// The viewer as a page of its own: everything it needs is in it, or beside it in a folder.

import { openWorkerEngine } from "./worker_engine.js";
import { startViewer } from "./viewer.js";

/** Most workers: each has a copy of the scene in its memory. */
const MOST_WORKERS = 4;

/** Returns the bytes that are in the page under an id, or in a file beside it. */
async function pageBytes(id, file) {
  const inside = document.getElementById(id);
  if (!inside) return new Uint8Array(await (await fetch(file)).arrayBuffer());
  const text = atob(inside.textContent);
  inside.remove();
  return Uint8Array.from(text, (letter) => letter.charCodeAt(0));
}

/** Undoes the page's compression. */
async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

async function startPage() {
  const whole = document.getElementById("geofan-wasm") !== null;
  const wasm = await inflated(await pageBytes("geofan-wasm", "geofan-web.wasm.deflate"));
  const space = await inflated(await pageBytes("geofan-space", "space.deflate"));
  const script = whole ? URL.createObjectURL(new Blob([await pageBytes("geofan-worker", "")], { type: "text/javascript" })) : "worker.js";
  const asked = Number(new URLSearchParams(location.hash.slice(1)).get("workers"));
  const count = Math.max(1, Math.min(asked || navigator.hardwareConcurrency || 1, MOST_WORKERS));
  startViewer(await openWorkerEngine(wasm, space, script, count));
}

startPage().catch((error) => {
  const trouble = document.getElementById("trouble");
  trouble.hidden = false;
  trouble.textContent = String(error.message ?? error);
});
