// Pixels to the screen. A picture of the display's own size is put there block by block; a smaller one is
// stretched when it is whole.

/** Bytes of a patch before its pixels: eight numbers. */
const PATCH_HEAD = 32;

/** Most pixels of a display: beyond, its picture is stretched. */
const MOST_PIXELS = 2560 * 1440;

/**
 * @param {HTMLCanvasElement} canvas @param {(event: object) => void} send
 * @param {(blob: Blob) => void} save
 */
export function createDisplay(canvas, send, save) {
  const context = canvas.getContext("2d", { alpha: false });
  const sheet = document.createElement("canvas");
  const captured = document.createElement("canvas");
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
      sheet.getContext("2d").putImageData(before, 0, 0);
      context.drawImage(sheet, 0, 0, width, height);
    }
    send({ type: "resize", width, height });
  }

  /** Shows a patch: an ArrayBuffer as PROTOCOL.md tells. */
  function show(buffer) {
    const head = new DataView(buffer, 0, PATCH_HEAD);
    const [flags, frame, width, height, x, y, w, h] = Array.from({ length: 8 }, (_, i) => head.getUint32(4 * i, true));
    const image = new ImageData(new Uint8ClampedArray(buffer, PATCH_HEAD), w, h);
    const last = (flags & 2) !== 0;
    if (flags & 1) {
      putOn(captured, width, height, image, x, y);
      if (last) captured.toBlob((blob) => blob && save(blob), "image/png");
      return;
    }
    if (width === canvas.width && height === canvas.height) {
      context.putImageData(image, x, y);
    } else {
      putOn(sheet, width, height, image, x, y);
      if (last) context.drawImage(sheet, 0, 0, canvas.width, canvas.height);
    }
    if (!last) return;
    stats = { frames: stats.frames + 1, shown: `${width}×${height}` };
    const tell = () => send({ type: "shown", frame });
    if (document.hidden) tell();
    else requestAnimationFrame(tell);
  }

  function putOn(target, width, height, image, x, y) {
    if (target.width !== width || target.height !== height) {
      target.width = width;
      target.height = height;
    }
    target.getContext("2d").putImageData(image, x, y);
  }

  new ResizeObserver(fit).observe(canvas);
  return { show, fit, stats: () => stats };
}
