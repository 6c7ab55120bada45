// The settings in the page's address. In: the part behind the #. Out: what it says, and the names of what means nothing.

import { KINDS, MOST_SIDE, SAVED_SAMPLES, SKIES } from "./panel.js";

/** @typedef {import("./types").Settings} Settings */

/** What the names of the manifold's parameters begin with there. */
export const PARAMETER = "set.";

/** The three settings that are a place, together. @type {("at" | "look" | "up")[]} */
const PLACE = ["at", "look", "up"];

/** A number. @param {string} text */
function finite(text) {
  const x = text.trim() ? Number(text) : NaN;
  return Number.isFinite(x) ? x : undefined;
}

/** A number above zero. @param {string} text */
function positive(text) {
  const x = finite(text);
  return x !== undefined && x > 0 ? x : undefined;
}

/** A number from 0 to 1. @param {string} text */
function share(text) {
  const x = finite(text);
  return x !== undefined && x >= 0 && x <= 1 ? x : undefined;
}

/** Three numbers. @param {string} text */
function triple(text) {
  const numbers = text.split(",").map(finite).filter((x) => x !== undefined);
  return numbers.length === 3 && text.split(",").length === 3 ? numbers : undefined;
}

/** Whole numbers between two. @param {number} least @param {number} most @returns {(text: string) => number | undefined} */
const whole = (least, most) => (text) => {
  const x = finite(text);
  return x !== undefined && Number.isInteger(x) && x >= least && x <= most ? x : undefined;
};

/** One of several words. @template {string} Word @param {Word[]} words @returns {(text: string) => Word | undefined} */
const oneOf = (words) => (text) => words.find((word) => word === text);

/** No or yes. @param {string} text */
const flag = (text) => ({ 0: false, 1: true })[text];

const kindNamed = oneOf(KINDS.map(([kind]) => kind));

/**
 * What each setting means; nothing if it means nothing. Numbers that are only too large become the
 * largest that can be, later: here they must fit into messages.
 * @type {{ [Name in keyof Settings]-?: (text: string) => Settings[Name] }}
 */
const READERS = {
  at: triple, look: triple, up: triple, fov: positive,
  show: kindNamed, split: (text) => (text === "" ? null : kindNamed(text)), sky: oneOf(SKIES.map(([sky]) => sky)),
  exposure: finite, moving: share, still: whole(1, 2 ** 16 - 1), paths: whole(0, 2 ** 32 - 1), beyond: flag,
  speed: positive, overlay: flag,
  "save.width": whole(1, MOST_SIDE), "save.height": whole(1, MOST_SIDE),
  "save.samples": (text) => SAVED_SAMPLES.find((n) => String(n) === text), "save.format": oneOf(["png", "exr"]),
  workers: whole(1, Infinity),
};

/** @param {string} name @returns {name is keyof Settings} */
const isSetting = (name) => Object.hasOwn(READERS, name);

/** Reads the settings; parameters of the manifold by their names. @param {string} hash */
export function settingsIn(hash) {
  /** @type {Settings} */
  const settings = {};
  /** @type {Map<string, number>} */
  const parameters = new Map();
  /** @type {string[]} */
  const wrong = [];
  for (const [name, text] of new URLSearchParams(hash.slice(1))) {
    const parameter = name.startsWith(PARAMETER);
    const read = parameter ? finite : isSetting(name) ? READERS[name] : () => undefined;
    const value = read(text);
    if (value === undefined) wrong.push(name);
    else if (parameter) parameters.set(name.slice(PARAMETER.length), Number(value));
    else Object.assign(settings, { [name]: value });
  }
  const placed = PLACE.filter((name) => settings[name]);
  if (placed.length < PLACE.length) {
    for (const name of placed) delete settings[name];
    wrong.push(...placed);
  }
  return { settings, parameters, wrong };
}
