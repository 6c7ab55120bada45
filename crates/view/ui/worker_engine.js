// The engine in the page itself: a session here, drawing in workers. Each has the same WebAssembly and its own
// memory, so nothing is shared and no special headers are needed.

/**
 * Calls of one WebAssembly instance.
 * @param {WebAssembly.Exports} exported
 */
function instanceCalls(exported) {
  const exports = /** @type {{ memory: WebAssembly.Memory } & Record<string, (...numbers: number[]) => number>} */ (/** @type {unknown} */ (exported));
  const encoder = new TextEncoder();
  const decoder = new TextDecoder();
  return {
    exports,
    /** Gives bytes, or a text, to the next call. @param {Uint8Array | string} content */
    give(content) {
      const bytes = typeof content === "string" ? encoder.encode(content) : content;
      const place = exports.geofan_input(bytes.length);
      new Uint8Array(exports.memory.buffer, place, bytes.length).set(bytes);
    },
    /** Takes the bytes of the last call. */
    take: () => new Uint8Array(exports.memory.buffer, exports.geofan_output(), exports.geofan_output_length()).slice(),
    takeText() { return decoder.decode(this.take()); },
  };
}

/**
 * Opens the engine.
 * @param {WebAssembly.Module} module @param {Uint8Array} space @param {Worker[]} workers which have nothing to do yet
 */
export async function openWorkerEngine(module, space, workers) {
  /** @type {import("./types").ViewEngine} */
  const engine = { send, onpatch: () => {}, onmessage: () => {}, onopen: () => {}, onlost: () => {} };
  const count = workers.length;
  const session = instanceCalls((await WebAssembly.instantiate(module, {})).exports);
  // They make their drawings while the session is made here; what they say comes when this function is done.
  // (No function in here uses module or space, because it would keep them as long as the engine.)
  for (const made of workers) {
    made.onmessage = ({ data }) => answer(made, data);
    made.onerror = (event) => engine.onmessage({ type: "broken", text: event.message });
    made.postMessage({ module, space });
  }
  session.give(space);
  if (session.exports.geofan_open_session() !== 0) throw new Error(session.takeText());
  const now = () => performance.now() / 1e3;
  /** @type {Map<string, number>} */
  const settings = new Map();
  /** @type {Worker[]} */
  const free = [];
  /** A chunk of the table that workers decode one after another, while the others draw. @type {{ number: number, left: Worker[], busy: boolean } | null} */
  let chunk = null;
  let drawn = false;

  /**
   * Takes what a worker says: that it is ready, what was wrong, an answer, or a chunk that it has decoded.
   * @param {Worker} made @param {{ trouble?: string, answer?: Uint8Array, chunk?: number }} data
   */
  function answer(made, data) {
    if (data.trouble !== undefined) tellTrouble(data.trouble);
    if (data.answer) {
      session.give(data.answer);
      session.exports.geofan_accept(now());
      drawn = true;
    }
    if (data.chunk !== undefined && chunk) {
      chunk.busy = false;
      if (chunk.left.length === 0) {
        session.exports.geofan_decoded(chunk.number);
        chunk = null;
      }
    }
    if (!free.includes(made)) free.push(made);
    pump();
  }

  /** @param {string} text */
  function tellTrouble(text) {
    session.give(text);
    session.exports.geofan_trouble();
  }

  /** @param {import("./types").ViewerEvent} event */
  function send(event) {
    if (event.type === "parameter") {
      const before = settings.get(event.name);
      settings.set(event.name, event.value);
      const text = JSON.stringify([...settings]);
      session.give(text);
      if (session.exports.geofan_set_session() !== 0) {
        tellTrouble(session.takeText());
        if (before === undefined) settings.delete(event.name);
        else settings.set(event.name, before);
      } else for (const made of workers) made.postMessage({ settings: text });
    } else {
      if (event.type === "sky") for (const made of workers) made.postMessage({ sky: JSON.stringify(event.sky) });
      session.give(JSON.stringify(event));
      session.exports.geofan_event(now());
    }
    pump();
  }

  /** Hands work to free workers, and pixels and panels on. */
  function pump() {
    while (session.exports.geofan_patch() !== 0) engine.onpatch(session.take().buffer);
    decodeAhead(count > 1);
    while (free.length > 0 && session.exports.geofan_next(now(), count) !== 0) {
      const work = session.take();
      free.pop()?.postMessage({ work }, [work.buffer]);
    }
    decodeAhead(true);
    while (session.exports.geofan_message(now()) !== 0) engine.onmessage(JSON.parse(session.takeText()));
  }

  /** Gives the next chunk to a free worker, unless one decodes already. @param {boolean} allowed */
  function decodeAhead(allowed) {
    if (!allowed || !drawn || chunk?.busy) return;
    if (!chunk) {
      const number = session.exports.geofan_next_chunk(now());
      if (number < 0) return;
      chunk = { number, left: [...workers], busy: false };
    }
    const { number, left } = chunk;
    const at = left.findIndex((made) => free.includes(made));
    if (at < 0) return;
    const [made] = left.splice(at, 1);
    free.splice(free.indexOf(made), 1);
    chunk.busy = true;
    made.postMessage({ chunk: number });
  }

  const beat = () => {
    pump();
    requestAnimationFrame(beat);
  };
  setTimeout(() => {
    engine.onopen();
    beat();
  }, 0);
  return engine;
}
