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
 * What a worker says: that it is free again, after an answer or a section that it has decoded; that it has loaded the scene
 * with the parameters of this number; what was wrong with them; or that it can do nothing more.
 * @typedef {{ free?: boolean, answer?: Uint8Array, section?: number, loaded?: number, trouble?: string, broken?: string }} Told
 */

/**
 * Opens the engine.
 * @param {WebAssembly.Module} module @param {Uint8Array} space @param {Worker[]} workers which have nothing to do yet
 */
export async function openWorkerEngine(module, space, workers) {
  /** @type {import("./types").ViewEngine} */
  const engine = { send: (event) => safely(() => send(event)), onpatch: () => {}, onmessage: () => {}, onopen: () => {}, onlost: () => {} };
  const session = instanceCalls((await WebAssembly.instantiate(module, {})).exports);
  // They make their drawings while the session is made here; what they say comes when this function is done.
  // (No function in here uses module or space, because it would keep them as long as the engine.)
  for (const made of workers) {
    made.onmessage = ({ data }) => safely(() => listen(made, data));
    made.onerror = (event) => safely(() => leave(made, event.message));
    made.postMessage({ module, space });
  }
  session.give(space);
  if (session.exports.geofan_open_session() !== 0) throw new Error(session.takeText());
  const now = () => performance.now() / 1e3;
  /** Workers that have not failed. */
  let crew = [...workers];
  /** @type {Worker[]} */
  const free = [];
  /** What the others draw. @type {Map<Worker, Uint8Array>} */
  const drawing = new Map();
  /** What workers that have failed were to draw, for another one; and all that has been handed out twice. @type {Uint8Array[]} */
  let lost = [];
  /** @type {WeakSet<Uint8Array>} */
  const again = new WeakSet();
  /** A section of the table that workers decode one after another, while the others draw. @type {{ number: number, left: Worker[], by: Worker | null } | null} */
  let section = null;
  let drawn = false;
  /** All parameters as they are in the package, once a panel has told them. @type {Map<string, number> | null} */
  let packed = null;
  /** Parameters that were moved: as the session has them, and as all workers had them last. @type {Map<string, number>[]} */
  let [moved, loaded] = [new Map(), new Map()];
  /** The place of the camera, as the last panel tells it. */
  let pose = /** @type {import("./types").Panel["pose"] | null} */ (null);
  /** Parameters that workers load: who has not said yet whether it can, what was wrong, and where the camera was before. @type {Map<number, { moved: Map<string, number>, left: Set<Worker>, done: Worker[], trouble: string, pose: import("./types").Panel["pose"] | null }>} */
  const loads = new Map();
  let newest = 0;
  let failed = false;

  /** Does something with the session, unless that has failed; what fails now is its end. @param {() => void} use */
  function safely(use) {
    if (failed) return;
    try {
      use();
    } catch (error) {
      failed = true;
      console.error(error);
      engine.onmessage({ type: "broken", text: String(error instanceof Error ? error.message : error) });
    }
  }

  /** @param {Worker} made @param {Told} told */
  function listen(made, told) {
    if (!crew.includes(made)) return;
    if (told.broken !== undefined) return leave(made, told.broken);
    if (told.loaded !== undefined) endLoad(made, told.loaded, told.trouble ?? "");
    else if (told.trouble !== undefined) tellTrouble(told.trouble);
    if (told.answer) {
      session.give(told.answer);
      session.exports.geofan_accept(now());
      drawn = true;
    }
    if (told.section !== undefined && section?.by === made) {
      section.by = null;
      endChunk();
    }
    if (told.free) {
      drawing.delete(made);
      free.push(made);
    }
    pump();
  }

  /** Does without a worker that has failed. @param {Worker} made @param {string} why */
  function leave(made, why) {
    if (!crew.includes(made)) return;
    crew = crew.filter((other) => other !== made);
    if (free.includes(made)) free.splice(free.indexOf(made), 1);
    const work = drawing.get(made);
    drawing.delete(made);
    if (work) lost.push(work);
    // What two have failed at, or what nobody is left for, is left out.
    const given = lost.filter((one) => crew.length === 0 || again.has(one));
    lost = lost.filter((one) => !given.includes(one));
    for (const one of given) {
      session.give(one);
      session.exports.geofan_fail(now());
    }
    if (section) {
      section.left = section.left.filter((other) => other !== made);
      if (section.by === made) section.by = null;
      endChunk();
    }
    for (const number of loads.keys()) endLoad(made, number, "");
    engine.onmessage({ type: "broken", text: why });
    pump();
  }

  /** Tells the session of a section that all workers have decoded. */
  function endChunk() {
    if (!section || section.by || section.left.length > 0) return;
    session.exports.geofan_decoded(section.number);
    section = null;
  }

  /** @param {string} text */
  function tellTrouble(text) {
    session.give(text);
    session.exports.geofan_trouble();
  }

  /**
   * Returns all parameters as text, or none if they are as packed: only then the light of lamps is theirs.
   * @param {Map<string, number>} moved
   */
  function textOf(moved) {
    const isMoved = [...moved].some(([name, value]) => packed?.get(name) !== value);
    return JSON.stringify(isMoved ? [...new Map([...(packed ?? []), ...moved])] : []);
  }

  /** Loads the session's space with these parameters; returns whether that can be. @param {Map<string, number>} wanted */
  function setSession(wanted) {
    session.give(textOf(wanted));
    const done = session.exports.geofan_set_session() === 0;
    // What is still being decoded is of the table before.
    if (done) [moved, section] = [wanted, null];
    else tellTrouble(session.takeText());
    return done;
  }

  /** @param {string} name @param {number} value */
  function setParameter(name, value) {
    if (!setSession(new Map(moved).set(name, value))) return;
    newest += 1;
    loads.set(newest, { moved, left: new Set(crew), done: [], trouble: "", pose });
    for (const made of crew) made.postMessage({ settings: textOf(moved), number: newest });
  }

  /**
   * Takes note of what a worker says of parameters. Those that workers refuse the session gives up again, if no others
   * have been asked for since.
   * @param {Worker} made @param {number} number @param {string} trouble
   */
  function endLoad(made, number, trouble) {
    const load = loads.get(number);
    if (!load?.left.delete(made)) return;
    load.trouble ||= trouble;
    if (!trouble) load.done.push(made);
    if (load.left.size > 0) return;
    loads.delete(number);
    if (!load.trouble) loaded = load.moved;
    else if (number === newest && setSession(loaded)) {
      // The camera may have been nowhere in between.
      if (load.pose) send({ type: "place", ...load.pose });
      tellTrouble(load.trouble);
      // Those that could load them go back, too.
      for (const other of load.done) other.postMessage({ settings: textOf(loaded), number: 0 });
    }
  }

  /** @param {import("./types").ViewerEvent} event */
  function send(event) {
    if (event.type === "parameter") setParameter(event.name, event.value);
    else {
      if (event.type === "sky") for (const made of crew) made.postMessage({ sky: JSON.stringify(event.sky) });
      session.give(JSON.stringify(event));
      session.exports.geofan_event(now());
    }
    pump();
  }

  /** Hands work to free workers, and pixels and panels on. */
  function pump() {
    while (session.exports.geofan_patch() !== 0) engine.onpatch(session.take().buffer);
    decodeAhead(crew.length > 1);
    while (free.length > 0) {
      const second = lost.shift();
      if (second) again.add(second);
      const work = second ?? (session.exports.geofan_next(now(), crew.length) !== 0 ? session.take() : null);
      const made = work && free.pop();
      if (!made) break;
      drawing.set(made, work);
      made.postMessage({ work });
    }
    decodeAhead(true);
    while (session.exports.geofan_message(now()) !== 0) {
      /** @type {import("./types").Message} */
      const message = JSON.parse(session.takeText());
      if (message.type === "panel") {
        packed ??= new Map(message.panel.parameters);
        message.panel.chosen = message.panel.parameters.filter(([name, value]) => packed?.get(name) !== value).map(([name]) => name);
        pose = message.panel.pose;
      }
      engine.onmessage(message);
    }
  }

  /** Gives the next section to a free worker, unless one decodes already. @param {boolean} allowed */
  function decodeAhead(allowed) {
    if (!allowed || !drawn || section?.by) return;
    if (!section) {
      const number = session.exports.geofan_next_section(now());
      if (number < 0) return;
      section = { number, left: [...crew], by: null };
    }
    const { number, left } = section;
    const at = left.findIndex((made) => free.includes(made));
    if (at < 0) return;
    const [made] = left.splice(at, 1);
    free.splice(free.indexOf(made), 1);
    section.by = made;
    made.postMessage({ section: number });
  }

  const beat = () => {
    safely(pump);
    if (!failed) requestAnimationFrame(beat);
  };
  setTimeout(() => {
    engine.onopen();
    beat();
  }, 0);
  return engine;
}
