// A worker of the page: unpacks and draws what it is asked for.

import { lzmaDecoded } from "./unpack.js";

let calls = null;

function give(content) {
  const bytes = typeof content === "string" ? new TextEncoder().encode(content) : content;
  const place = calls.geofan_input(bytes.length);
  new Uint8Array(calls.memory.buffer, place, bytes.length).set(bytes);
}

const take = () => new Uint8Array(calls.memory.buffer, calls.geofan_output(), calls.geofan_output_length()).slice();

/** What was wrong, in words, where a call says that something was; else nothing. */
const troubleOf = (code) => (code === 0 ? undefined : new TextDecoder().decode(take()));

async function obey(data) {
  if (data.packed) {
    const unpacked = lzmaDecoded(data.packed);
    postMessage({ unpacked }, [unpacked.buffer]);
  } else if (data.module) {
    calls = (await WebAssembly.instantiate(data.module, {})).exports;
    give(data.space);
    postMessage({ free: true, trouble: troubleOf(calls.geofan_open_drawing()) });
  } else if (data.settings) {
    give(data.settings);
    postMessage({ loaded: data.number, trouble: troubleOf(calls.geofan_set_drawing()) });
  } else if (data.sky) {
    give(data.sky);
    calls.geofan_dress();
  } else if (data.section !== undefined) {
    calls.geofan_decode(data.section);
    postMessage({ free: true, section: data.section });
  } else if (data.work) {
    give(data.work);
    calls.geofan_work();
    const answer = take();
    postMessage({ free: true, answer }, [answer.buffer]);
  }
}

// Each message waits for those before it: nothing can be done before everything is instantiated.
let turn = Promise.resolve();
onmessage = ({ data }) => {
  turn = turn.then(() => obey(data)).catch((error) => postMessage({ broken: String(error?.message ?? error) }));
};
