// The viewer as a page of its own: everything it needs is in it, or beside it in a folder.

import { bytesOfText, lzmaDecoded } from "./unpack.js";
import { openWorkerEngine } from "./worker_engine.js";
import { find, startViewer } from "./viewer.js";

/** Most workers: each has a copy of the scene in its memory. */
const MOST_WORKERS = 4;

/** Returns the bytes that are in the page under an id, or in a file beside it. @param {string} id @param {string} file */
async function pagePart(id, file) {
  const inside = document.getElementById(id);
  if (!inside) return new Uint8Array(await (await fetch(file)).arrayBuffer());
  const text = inside.textContent ?? "";
  inside.remove();
  return bytesOfText(text);
}

/**
 * Has a worker unpack a part, while this thread does something else.
 * @param {Worker} worker @param {Uint8Array} packed @returns {Promise<Uint8Array>}
 */
function unpackedBy(worker, packed) {
  return new Promise((done, failed) => {
    worker.onmessage = ({ data }) => (data.unpacked ? done(data.unpacked) : failed(new Error(data.broken)));
    worker.onerror = (event) => failed(new Error(event.message));
    worker.postMessage({ packed }, [packed.buffer]);
  });
}

async function startPage() {
  const whole = document.getElementById("geofan-wasm") !== null;
  const script = whole ? URL.createObjectURL(new Blob([find("geofan-worker").textContent ?? ""], { type: "text/javascript" })) : "worker.js";
  const asked = Number(new URLSearchParams(location.hash.slice(1)).get("workers"));
  const count = Math.max(1, Math.min(asked || navigator.hardwareConcurrency || 1, MOST_WORKERS));
  const workers = Array.from({ length: count }, () => new Worker(script));
  const space = unpackedBy(workers[0], await pagePart("geofan-space", "space.lzma"));
  const wasm = await pagePart("geofan-wasm", "geofan-web.wasm.lzma");
  const module = WebAssembly.compile(lzmaDecoded(wasm));
  startViewer(await openWorkerEngine(await module, await space, workers));
}

startPage().catch((error) => {
  const trouble = find("trouble");
  trouble.hidden = false;
  trouble.textContent = `This page is damaged, or this browser cannot open it: ${error.message ?? error}`;
  find("hint").textContent = "";
});
