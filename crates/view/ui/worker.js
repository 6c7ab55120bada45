// A worker of the page: unpacks and draws what it is asked for.

import { lzmaDecoded } from "./unpack.js";

let calls = null;

function give(content) {
  const bytes = typeof content === "string" ? new TextEncoder().encode(content) : content;
  const place = calls.geofan_input(bytes.length);
  new Uint8Array(calls.memory.buffer, place, bytes.length).set(bytes);
}

const take = () => new Uint8Array(calls.memory.buffer, calls.geofan_output(), calls.geofan_output_length()).slice();

onmessage = async ({ data }) => {
  if (data.packed) {
    const unpacked = lzmaDecoded(data.packed);
    postMessage({ unpacked }, [unpacked.buffer]);
  } else if (data.module) {
    calls = (await WebAssembly.instantiate(data.module, {})).exports;
    give(data.space);
    if (calls.geofan_open_drawing() !== 0) postMessage({ trouble: new TextDecoder().decode(take()) });
    else postMessage({});
  } else if (data.settings) {
    give(data.settings);
    if (calls.geofan_set_drawing() !== 0) postMessage({ trouble: new TextDecoder().decode(take()) });
  } else if (data.sky) {
    give(data.sky);
    calls.geofan_dress();
  } else if (data.chunk !== undefined) {
    calls.geofan_decode(data.chunk);
    postMessage({ chunk: data.chunk });
  } else if (data.work) {
    give(data.work);
    calls.geofan_work();
    const answer = take();
    postMessage({ answer }, [answer.buffer]);
  }
};
