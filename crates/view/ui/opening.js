// Begins a page in one file: unpacks its style sheet and its scripts, and puts them where they belong.

import { bytesOfText, lzmaDecoded } from "./unpack.js";

try {
  const packed = bytesOfText(document.getElementById("geofan-scripts")?.textContent ?? "");
  for (const [id, kind, text] of JSON.parse(new TextDecoder().decode(lzmaDecoded(packed)))) {
    if (kind === "text/css") {
      const style = document.querySelector("style");
      if (style) style.textContent = text;
      continue;
    }
    const script = document.createElement("script");
    [script.id, script.type, script.textContent] = [id, kind, text];
    document.body.append(script);
  }
} catch (error) {
  const hint = document.getElementById("hint");
  if (hint) hint.textContent = `This page is damaged: ${error}`;
}
