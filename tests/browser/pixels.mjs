// Holds the page's picture against the program's: the same scene, table, camera and size, when all is refined.
//
//   node pixels.mjs GEOFAN SCENE BUNDLE [chromium]

import { chromium } from "playwright-core";
import { spawn, execFileSync } from "node:child_process";
import { mkdtempSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";

const [geofan, scene, bundle, browserPath = "/usr/bin/chromium"] = process.argv.slice(2);
const file = path.join(mkdtempSync(path.join(tmpdir(), "geofan-pixels-")), "page.html");
execFileSync(geofan, ["view", scene, "--bundle", bundle, "--page", file]);
const viewer = spawn(geofan, ["view", scene, "--bundle", bundle, "--no-open"]);
const address = await new Promise((done) => viewer.stdout.on("data", (data) => done(String(data).trim())));
const flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
  "--disable-background-networking", "--disable-component-update", "--disable-sync"];
const browser = await chromium.launch({ executablePath: browserPath, args: flags });
const pictures = [];
for (const [at, samples] of [[address, 1], [`file://${file}`, 1], [address, 16], [`file://${file}`, 16]]) {
  const page = await browser.newPage({ viewport: { width: 640, height: 360 } });
  await page.goto(at);
  await page.waitForFunction(() => globalThis.geofan?.panel(), null, { timeout: 60000 });
  await page.evaluate((n) => globalThis.geofan.send({ type: "still", samples: n }), samples);
  await page.waitForTimeout(300);
  await page.waitForFunction(() => globalThis.geofan.panel().settled, null, { timeout: 180000 });
  await page.waitForTimeout(500);
  pictures.push(await page.evaluate(() => {
    const canvas = document.getElementById("picture");
    return [canvas.width, canvas.height, ...canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data];
  }));
  await page.close();
}
await browser.close();
viewer.kill();
for (const [i, samples] of [[0, 1], [2, 16]]) {
  const [a, b] = [pictures[i], pictures[i + 1]];
  let [differing, most] = [0, 0];
  for (let k = 2; k < a.length; k += 4) {
    const off = Math.max(...[0, 1, 2].map((c) => Math.abs(a[k + c] - b[k + c])));
    differing += off > 0;
    most = Math.max(most, off);
  }
  console.log(`${a[0]}x${a[1]}, ${samples} samples: ${differing} of ${a[0] * a[1]} pixels differ, by ${most} code values at most`);
}
