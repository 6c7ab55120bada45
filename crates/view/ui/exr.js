// Linear light to an OpenEXR file: scan lines of single-precision numbers, not compressed (Technical Introduction to
// OpenEXR; OpenEXR File Layout, openexr.com).

/** Channels as they stand in a file: in the order of their names. */
const CHANNELS = ["B", "G", "R"];

/** Number of single-precision numbers among types of channels. */
const FLOAT = 2;

/**
 * Collects the blocks of a picture.
 * @param {number} width @param {number} height
 */
export function createExr(width, height) {
  const light = new Float32Array(3 * width * height);
  return {
    /** Takes a block: red, green, blue of each pixel. @param {Float32Array} block @param {number[]} place */
    put(block, [x, y, w, h]) {
      for (let row = 0; row < h; row += 1) light.set(block.subarray(3 * w * row, 3 * w * (row + 1)), 3 * ((y + row) * width + x));
    },
    /** The file. */
    file: () => new Blob(exrParts(light, width, height), { type: "image/x-exr" }),
  };
}

/** @param {Float32Array} light @param {number} width @param {number} height */
function exrParts(light, width, height) {
  const head = exrHead(width, height);
  const line = 8 + 12 * width;
  const offsets = new BigUint64Array(height);
  for (let y = 0; y < height; y += 1) offsets[y] = BigInt(head.length + 8 * height + y * line);
  const lines = new ArrayBuffer(line * height);
  for (let y = 0; y < height; y += 1) {
    const numbers = new DataView(lines, y * line, line);
    numbers.setInt32(0, y, true);
    numbers.setInt32(4, 12 * width, true);
    CHANNELS.forEach((_, k) => {
      const from = 3 * y * width + 2 - k;
      for (let x = 0; x < width; x += 1) numbers.setFloat32(8 + 4 * (k * width + x), light[from + 3 * x], true);
    });
  }
  return [head, offsets.buffer, lines];
}

/** @param {number} width @param {number} height */
function exrHead(width, height) {
  /** @type {number[]} */
  const bytes = [0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
  const text = (/** @type {string} */ words) => bytes.push(...new TextEncoder().encode(words), 0);
  const whole = (/** @type {number[]} */ ...numbers) => bytes.push(...new Uint8Array(new Int32Array(numbers).buffer));
  const real = (/** @type {number[]} */ ...numbers) => bytes.push(...new Uint8Array(new Float32Array(numbers).buffer));
  const attribute = (/** @type {string} */ name, /** @type {string} */ type, /** @type {() => void} */ write) => {
    text(name);
    text(type);
    const at = bytes.length;
    whole(0);
    write();
    new Uint8Array(new Int32Array([bytes.length - at - 4]).buffer).forEach((byte, i) => (bytes[at + i] = byte));
  };
  attribute("channels", "chlist", () => {
    for (const name of CHANNELS) {
      text(name);
      whole(FLOAT, 0, 1, 1);
    }
    bytes.push(0);
  });
  attribute("compression", "compression", () => bytes.push(0));
  attribute("dataWindow", "box2i", () => whole(0, 0, width - 1, height - 1));
  attribute("displayWindow", "box2i", () => whole(0, 0, width - 1, height - 1));
  attribute("lineOrder", "lineOrder", () => bytes.push(0));
  attribute("pixelAspectRatio", "float", () => real(1));
  attribute("screenWindowCenter", "v2f", () => real(0, 0));
  attribute("screenWindowWidth", "float", () => real(1));
  bytes.push(0);
  return new Uint8Array(bytes);
}
