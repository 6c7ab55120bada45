// What the user has asked for and the panel does not tell yet: a panel comes ten times a second, so a key that is
// pressed twice between two of them must not do the same thing twice.

/** Milliseconds in which the panel tells what was asked for; else it was refused. */
export const PATIENCE = 1000;

/** @typedef {import("./types").Panel} Panel */
/** What keys change by what it is now. @typedef {Pick<Panel, "kind" | "split" | "beyond" | "exposure"> & { passes: number, recording: boolean }} Choices */

/** What a panel tells of them. @param {Panel} panel @returns {Choices} */
const toldBy = ({ kind, split, beyond, exposure, passes, recording }) =>
  ({ kind, split, beyond, exposure, passes: passes[1], recording: recording !== null });

/** What an event asks for. @param {import("./types").ViewerEvent} event @returns {Partial<Choices>} */
function askedBy(event) {
  switch (event.type) {
    case "show": return { kind: event.kind, split: event.split };
    case "beyond": return { beyond: event.allowed };
    case "exposure": return { exposure: event.stops };
    case "paths": return { passes: event.passes };
    case "record": return { recording: event.on };
    default: return {};
  }
}

/** Remembers what has been asked for. */
export function createAsked() {
  /** @type {Partial<Choices>} */
  let asked = {};
  let since = 0;
  /** Values of parameters that no panel tells yet, however long the space takes to load, and since when. @type {Map<string, { value: number, since: number }>} */
  const untold = new Map();
  /** Parameters that were set from here. @type {Set<string>} */
  const moved = new Set();
  /** What parameters were before anybody chose other values. @type {Map<string, number>} */
  const given = new Map();
  /** Samples at rest, which no panel tells. @type {number | null} */
  let still = null;
  /** The last kind that was asked for. @type {Pick<Panel, "kind" | "split"> | null} */
  let shown = null;

  /** Takes note of an event that is sent. @param {import("./types").ViewerEvent} event */
  function note(event) {
    if (event.type === "still") still = event.samples;
    if (event.type === "show") shown = { kind: event.kind, split: event.split };
    if (event.type === "parameter") {
      untold.set(event.name, { value: event.value, since: performance.now() });
      moved.add(event.name);
    }
    const more = askedBy(event);
    if (Object.keys(more).length === 0) return;
    asked = { ...asked, ...more };
    since = performance.now();
  }

  /** Takes note of a panel: what it tells is no longer only asked for. @param {Panel} panel */
  function settle(panel) {
    settleParameters(panel);
    const told = toldBy(panel);
    const same = Object.entries(asked).every(([name, value]) => told[/** @type {keyof Choices} */ (name)] === value);
    if (same || performance.now() - since > PATIENCE) asked = {};
  }

  /** Takes note of given values; forgets those that a panel tells, and those that were refused: then it tells why, or that nothing else is to come. @param {Panel} panel */
  function settleParameters(panel) {
    const told = new Map(panel.parameters);
    for (const [name, value] of told) if (!panel.chosen.includes(name)) given.set(name, value);
    const isDone = panel.settled || panel.trouble !== null;
    for (const [name, { value, since }] of untold) {
      const refused = isDone && performance.now() - since > PATIENCE;
      if (refused || told.get(name) === value) untold.delete(name);
    }
  }

  /** What holds, or will when the engine has done what it was asked for. @param {Panel} panel @returns {Choices} */
  const now = (panel) => ({ ...toldBy(panel), ...asked });

  /** The parameters: what the panel tells, what is asked for besides, what was given at first if that is known, and whether they were set from here, or from another viewer of the same space. @param {Panel} panel */
  const parameters = (panel) => panel.parameters.map(([name, told]) => ({ name, told, asked: untold.get(name)?.value, given: given.get(name), own: moved.has(name) || panel.chosen.includes(name) }));

  /** The kind of picture for an address: without a table the one that was asked for, if any, because it comes with a table. @param {Panel} panel */
  const kinds = (panel) => (panel.promise === null ? shown : panel);

  return { note, settle, now, parameters, kinds, still: () => still, isLoading: () => untold.size > 0 };
}
