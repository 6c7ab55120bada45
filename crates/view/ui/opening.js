// Begins a page in one file: unpacks its scripts, and puts them where they run.

import { bytesOfText, lzmaDecoded } from "./unpack.js";

const packed = bytesOfText(document.getElementById("geofan-scripts")?.textContent ?? "");
for (const [id, kind, text] of JSON.parse(new TextDecoder().decode(lzmaDecoded(packed)))) {
  const script = document.createElement("script");
  [script.id, script.type, script.textContent] = [id, kind, text];
  document.body.append(script);
}
