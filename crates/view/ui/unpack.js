// What the page carries, made into bytes again: text, and LZMA, which browsers have no stream for.
// Formats: Igor Pavlov, "LZMA specification" (2015); the texts are those of the page's writer (page.rs): two
// letters for 13 bits, or, in a page in UTF-16, a code unit for two bytes.

/** Letters of the text, in the order of their values: what can be printed, without what HTML has a use for. */
const LETTERS = Array.from({ length: 94 }, (_, i) => String.fromCharCode(33 + i)).filter((letter) => !"\"&<".includes(letter));

/** Stands before a code unit with its highest bit turned, which HTML would not carry as it is. */
const ESCAPE = 0xe000;

/** Returns the bytes that a text of the page stands for. @param {string} text */
export function bytesOfText(text) {
  return document.characterSet === "UTF-16LE" ? bytesOfCodeUnits(text) : bytesOfLetters(text);
}

/** @param {string} text */
function bytesOfCodeUnits(text) {
  const bytes = new Uint8Array(2 * text.length);
  let at = 0;
  for (let i = 0; i < text.length; i += 1) {
    let unit = text.charCodeAt(i);
    if (unit === ESCAPE) unit = text.charCodeAt((i += 1)) ^ 0x8000;
    bytes[at++] = unit & 255;
    bytes[at++] = unit >> 8;
  }
  return bytes.subarray(0, at);
}

/** The least bits come first. @param {string} text */
function bytesOfLetters(text) {
  const values = new Uint8Array(128);
  LETTERS.forEach((letter, i) => (values[letter.charCodeAt(0)] = i));
  const bytes = new Uint8Array(Math.floor((text.length / 2) * 13 / 8));
  let [bits, count, at] = [0, 0, 0];
  for (let i = 0; i + 1 < text.length; i += 2) {
    bits |= (values[text.charCodeAt(i)] + LETTERS.length * values[text.charCodeAt(i + 1)]) << count;
    for (count += 13; count >= 8 && at < bytes.length; count -= 8) {
      bytes[at++] = bits & 255;
      bits >>>= 8;
    }
  }
  return bytes;
}

/** Bits of the shortest distances that are coded one after another, and of all trees that are used below. */
const [ALIGN_BITS, FULL_DISTANCES, END_POSITION_MODEL] = [4, 128, 14];

/** Decodes bits by adaptive probabilities. @param {Uint8Array} input @param {number} start */
function rangeDecoder(input, start) {
  let at = start + 5;
  // Range and code, where numbers of 32 bits are kept as they are: in variables they would be boxed again and again.
  const held = new Uint32Array([0xffffffff, new DataView(input.buffer, input.byteOffset + start).getUint32(1)]);

  function refill() {
    held[0] <<= 8;
    held[1] = (held[1] << 8) | input[at++];
  }

  /** @param {Uint16Array} chances @param {number} i */
  function bit(chances, i) {
    const chance = chances[i];
    const bound = Math.imul(held[0] >>> 11, chance) >>> 0;
    let value = 0;
    if (held[1] < bound) {
      held[0] = bound;
      chances[i] = chance + ((2048 - chance) >> 5);
    } else {
      held[0] -= bound;
      held[1] -= bound;
      chances[i] = chance - (chance >> 5);
      value = 1;
    }
    if (held[0] < 0x1000000) refill();
    return value;
  }

  /** Bits without probabilities, the highest first. @param {number} count */
  function plain(count) {
    let value = 0;
    for (; count > 0; count -= 1) {
      held[0] >>>= 1;
      const above = held[1] >= held[0] ? 1 : 0;
      if (above) held[1] -= held[0];
      value = value * 2 + above;
      if (held[0] < 0x1000000) refill();
    }
    return value;
  }

  /** A number of so many bits, the highest first. @param {Uint16Array} chances @param {number} base @param {number} count */
  function tree(chances, base, count) {
    let node = 1;
    for (let i = 0; i < count; i += 1) node = node * 2 + bit(chances, base + node);
    return node - (1 << count);
  }

  /** A number of so many bits, the lowest first. @param {Uint16Array} chances @param {number} base @param {number} count */
  function reversed(chances, base, count) {
    let [node, value] = [1, 0];
    for (let i = 0; i < count; i += 1) {
      const next = bit(chances, base + node);
      node = node * 2 + next;
      value |= next << i;
    }
    return value;
  }

  return { bit, plain, tree, reversed };
}

/** @param {number} count */
const evenChances = (count) => new Uint16Array(count).fill(1024);

/** Decodes lengths of matches. @param {ReturnType<typeof rangeDecoder>} decoder */
function lengthDecoder(decoder) {
  const [choice, low, middle, high] = [2, 128, 128, 256].map(evenChances);
  /** @param {number} position */
  return (position) => {
    if (!decoder.bit(choice, 0)) return 2 + decoder.tree(low, position << 3, 3);
    if (!decoder.bit(choice, 1)) return 10 + decoder.tree(middle, position << 3, 3);
    return 18 + decoder.tree(high, 0, 8);
  };
}

/**
 * Undoes LZMA of a stream with the usual header of 13 bytes, which tells the length.
 * @param {Uint8Array} input @returns {Uint8Array<ArrayBuffer>}
 */
export function lzmaDecoded(input) {
  const head = new DataView(input.buffer, input.byteOffset, 13);
  const properties = head.getUint8(0);
  const lc = properties % 9;
  const lp = Math.floor(properties / 9) % 5;
  const positionMask = (1 << Math.floor(properties / 45)) - 1;
  const output = new Uint8Array(head.getUint32(5, true));
  const decoder = rangeDecoder(input, 13);
  const { bit } = decoder;
  const literals = evenChances(0x300 << (lc + lp));
  const isMatch = evenChances(192);
  const [isRepeat, isRepeat0, isRepeat1, isRepeat2] = [12, 12, 12, 12].map(evenChances);
  const isRepeat0Long = evenChances(192);
  const slots = evenChances(4 * 64);
  const [near, align] = [evenChances(FULL_DISTANCES), evenChances(1 << ALIGN_BITS)];
  const [matchLength, repeatLength] = [lengthDecoder(decoder), lengthDecoder(decoder)];
  let state = 0;
  let [rep0, rep1, rep2, rep3] = [0, 0, 0, 0];
  let at = 0;

  function literal() {
    const before = at > 0 ? output[at - 1] : 0;
    const base = 0x300 * (((at & ((1 << lp) - 1)) << lc) + (before >> (8 - lc)));
    let symbol = 1;
    if (state >= 7) {
      let match = output[at - rep0 - 1];
      while (symbol < 0x100) {
        const expected = (match >> 7) & 1;
        match <<= 1;
        const next = bit(literals, base + ((1 + expected) << 8) + symbol);
        symbol = symbol * 2 + next;
        if (next !== expected) break;
      }
    }
    while (symbol < 0x100) symbol = symbol * 2 + bit(literals, base + symbol);
    output[at++] = symbol & 255;
    state = state < 4 ? 0 : state < 10 ? state - 3 : state - 6;
  }

  /** @param {number} length */
  function distance(length) {
    const slot = decoder.tree(slots, Math.min(length - 2, 3) << 6, 6);
    if (slot < 4) return slot;
    const count = (slot >> 1) - 1;
    const start = (2 | (slot & 1)) * 2 ** count;
    if (slot < END_POSITION_MODEL) return start + decoder.reversed(near, start - slot, count);
    return start + decoder.plain(count - ALIGN_BITS) * 16 + decoder.reversed(align, 0, ALIGN_BITS);
  }

  /** Reads which of the last distances comes again; returns the length, 0 for a single byte that is written already. */
  function repeat(/** @type {number} */ position) {
    if (!bit(isRepeat0, state)) {
      if (!bit(isRepeat0Long, (state << 4) + position)) {
        state = state < 7 ? 9 : 11;
        output[at] = output[at - rep0 - 1];
        at += 1;
        return 0;
      }
    } else if (!bit(isRepeat1, state)) {
      [rep0, rep1] = [rep1, rep0];
    } else if (!bit(isRepeat2, state)) {
      [rep0, rep1, rep2] = [rep2, rep0, rep1];
    } else {
      [rep0, rep1, rep2, rep3] = [rep3, rep0, rep1, rep2];
    }
    const length = repeatLength(position);
    state = state < 7 ? 8 : 11;
    return length;
  }

  while (at < output.length) {
    const position = at & positionMask;
    if (!bit(isMatch, (state << 4) + position)) {
      literal();
      continue;
    }
    let length;
    if (bit(isRepeat, state)) {
      length = repeat(position);
    } else {
      [rep1, rep2, rep3] = [rep0, rep1, rep2];
      length = matchLength(position);
      state = state < 7 ? 7 : 10;
      rep0 = distance(length);
    }
    const from = at - rep0 - 1;
    const end = Math.min(at + length, output.length);
    for (let k = from; at < end; k += 1) output[at++] = output[k];
  }
  return output;
}
