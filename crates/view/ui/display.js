// Pixels to the screen. A picture of the display's own size is put there block by block; a smaller one is
// stretched when it is whole.

import { createExr } from "./exr.js";

/** Bytes of a patch before its pixels: eight numbers. */
const PATCH_HEAD = 32;

/** Most pixels of a display: beyond, its picture is stretched. */
const MOST_PIXELS = 2560 * 1440;

/** The paper of a canvas. @param {HTMLCanvasElement} canvas @param {boolean} alpha */
export function paperOf(canvas, alpha = true) {
  const paper = canvas.getContext("2d", { alpha });
  if (!paper) throw new Error("this browser draws no pictures on a canvas");
  return paper;
}

/** @param {HTMLCanvasElement} canvas @param {import("./types").Send} send @param {import("./types").Save} save */
export function createDisplay(canvas, send, save) {
  const context = paperOf(canvas, false);
  const sheet = document.createElement("canvas");
  const captured = document.createElement("canvas");
  /** Linear light of a captured picture, block by block. @type {{ key: string, exr: ReturnType<typeof createExr> } | null} */
  let capturedLight = null;
  let stats = { frames: 0, shown: "" };

  function fit() {
    const density = Math.min(devicePixelRatio || 1, 2);
    let [width, height] = [canvas.clientWidth * density, canvas.clientHeight * density];
    const shrink = Math.min(1, Math.sqrt(MOST_PIXELS / (width * height)));
    [width, height] = [Math.max(16, Math.round(width * shrink)), Math.max(16, Math.round(height * shrink))];
    if (canvas.width === width && canvas.height === height) return;
    const before = canvas.width > 0 ? context.getImageData(0, 0, canvas.width, canvas.height) : null;
    canvas.width = width;
    canvas.height = height;
    if (before) {
      sheet.width = before.width;
      sheet.height = before.height;
      paperOf(sheet).putImageData(before, 0, 0);
      context.drawImage(sheet, 0, 0, width, height);
    }
    send({ type: "resize", width, height });
  }

  /** Shows a patch, as PROTOCOL.md tells. @param {ArrayBuffer} buffer */
  function show(buffer) {
    const head = new DataView(buffer, 0, PATCH_HEAD);
    const [flags, frame, width, height, x, y, w, h] = Array.from({ length: 8 }, (_, i) => head.getUint32(4 * i, true));
    const last = (flags & 2) !== 0;
    if (flags & 4) {
      const exr = lightOf(frame, width, height);
      exr.put(new Float32Array(buffer, PATCH_HEAD), [x, y, w, h]);
      if (last) {
        save("exr", exr.file());
        capturedLight = null;
      }
      return;
    }
    const image = new ImageData(new Uint8ClampedArray(buffer, PATCH_HEAD), w, h);
    if (flags & 1) {
      putOn(captured, width, height, image, x, y);
      if (last) captured.toBlob((blob) => blob && save("png", blob), "image/png");
      return;
    }
    if (width === canvas.width && height === canvas.height) {
      context.putImageData(image, x, y);
    } else {
      putOn(sheet, width, height, image, x, y);
      // Colours of classes that are blended would be those of other classes.
      context.imageSmoothingEnabled = (flags & 8) === 0;
      if (last) context.drawImage(sheet, 0, 0, canvas.width, canvas.height);
    }
    if (!last) return;
    stats = { frames: stats.frames + 1, shown: `${width}×${height}` };
    canvas.dispatchEvent(new CustomEvent("picture", { detail: frame }));
    const tell = () => send({ type: "shown", frame });
    if (document.hidden) tell();
    else requestAnimationFrame(tell);
  }

  /**
   * The light of the picture that a block is of. One that was left before it was whole never comes to its end, so
   * another picture takes its place. @param {number} frame @param {number} width @param {number} height
   */
  function lightOf(frame, width, height) {
    const key = `${frame}: ${width}×${height}`;
    if (capturedLight?.key !== key) capturedLight = { key, exr: createExr(width, height) };
    return capturedLight.exr;
  }

  /**
   * @param {HTMLCanvasElement} target @param {number} width @param {number} height
   * @param {ImageData} image @param {number} x @param {number} y
   */
  function putOn(target, width, height, image, x, y) {
    if (target.width !== width || target.height !== height) {
      target.width = width;
      target.height = height;
    }
    paperOf(target).putImageData(image, x, y);
  }

  /** Fits when the pixels of the screen become others under the same layout: a window goes to another screen. */
  function watchDensity() {
    const refit = () => {
      fit();
      watchDensity();
    };
    matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", refit, { once: true });
  }

  new ResizeObserver(fit).observe(canvas);
  watchDensity();
  return { show, fit, stats: () => stats };
}
