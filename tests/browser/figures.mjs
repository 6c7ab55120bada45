// Figures of the viewer in a real browser: time to the first picture, moving pictures a second and their size, time
// from an input to the picture that shows it, by the program and as a page with one and two workers; times between
// pictures of a flight through a table with a box of cameras; then minutes of random input on the page, with its memory.
//
//   node figures.mjs GEOFAN SCENE BUNDLE BOX_SCENE BOX_BUNDLE [minutes=5] [seed=1] [chromium]
//
// The camera of BOX_SCENE is in the box. ONLY=opening, box or random does one of the three parts.

import { chromium } from "playwright-core";
import { spawn, execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, readdirSync, statSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";

const [geofan, scene, bundle, boxScene, boxBundle, minutes = "5", seed = "1", browserPath = "/usr/bin/chromium"] = process.argv.slice(2);
if (!boxBundle) {
  console.error("usage: node figures.mjs GEOFAN SCENE BUNDLE BOX_SCENE BOX_BUNDLE [minutes=5] [seed=1] [chromium]");
  process.exit(2);
}
const work = mkdtempSync(path.join(tmpdir(), "geofan-figures-"));

/** Writes the page of a scene with its table. @param {string} name @param {string} scene @param {string} bundle */
function pageOf(name, scene, bundle) {
  const file = path.join(work, `${name}.html`);
  execFileSync(geofan, ["view", scene, "--bundle", bundle, "--page", file]);
  console.log(`${name}: page of ${statSync(file).size} bytes`);
  return `file://${file}`;
}
const flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
  "--disable-background-networking", "--disable-component-update", "--disable-sync"];
const middle = (list) => [...list].sort((a, b) => a - b)[list.length >> 1];

/** All of it is the display: in windows as low as this the settings are folded. */
const VIEWPORT = { width: 640, height: 360 };

async function open(browser, address) {
  const page = await (await browser.newContext({ viewport: VIEWPORT })).newPage();
  const errors = [];
  page.on("pageerror", (error) => errors.push(error.message));
  const began = performance.now();
  await page.goto(address);
  await page.waitForFunction(() => globalThis.geofan?.stats().frames > 0, null, { timeout: 60000, polling: 5 });
  return { page, ready: performance.now() - began, errors };
}

/** Flies for some seconds to and fro, and returns the medians of what the panel tells meanwhile. */
async function flight(page) {
  await page.keyboard.down("KeyA");
  const seen = [];
  for (let i = 0; i < 60; i += 1) {
    await page.waitForTimeout(100);
    const panel = await page.evaluate(() => globalThis.geofan.panel());
    if (i > 15 && panel.rate) seen.push([panel.rate, panel.size[0], panel.seconds]);
    if (i === 30) { await page.keyboard.up("KeyA"); await page.keyboard.down("KeyD"); }
  }
  await page.keyboard.up("KeyD");
  const at = (k) => middle(seen.map((x) => x[k]));
  return `${at(0)?.toFixed(1)} pictures a second, ${at(1)} wide, each drawn in ${(1e3 * at(2)).toFixed(0)} ms`;
}

/** Turns the head again and again while the camera flies, and waits for the picture of each turn. */
async function inputs(page) {
  // So slowly that it does not come to the edge of the table's region, where nothing would move any more.
  await page.evaluate(() => [{ type: "home" }, { type: "speed", factor: 0.1 }].forEach(globalThis.geofan.send));
  await page.keyboard.down("KeyW");
  const waits = await page.evaluate(async () => {
    const canvas = document.getElementById("picture");
    // The first picture that comes may have been begun before the input.
    const second = () => new Promise((done) => {
      let count = 0;
      const take = () => {
        count += 1;
        if (count < 2) return;
        canvas.removeEventListener("picture", take);
        done(true);
      };
      canvas.addEventListener("picture", take);
      setTimeout(() => done(false), 2000);
    });
    const waits = [];
    for (let k = 0; k < 80; k += 1) {
      const began = performance.now();
      const shown = second();
      globalThis.geofan.send({ type: "look", right: k % 2 ? 0.02 : -0.02, down: 0 });
      waits.push((await shown) ? performance.now() - began : Infinity);
      // At no fixed time of a picture.
      await new Promise((done) => setTimeout(done, 20 + (37 * k) % 41));
    }
    return waits.sort((a, b) => a - b);
  });
  await page.keyboard.up("KeyW");
  await page.evaluate(() => [{ type: "home" }, { type: "speed", factor: 10 }].forEach(globalThis.geofan.send));
  const at = (share) => waits[Math.floor(share * (waits.length - 1))].toFixed(0);
  return `input to picture ${at(0.5)} ms (median of ${waits.length}; 95 %: ${at(0.95)}, longest ${at(1)}), of the second picture after it`;
}

/** Flies, and answers inputs, as large as the machine can; then at the display's own size. */
async function figures(page, name) {
  await page.waitForTimeout(1500);
  const flown = await flight(page);
  console.log(`${name}: ${flown}; ${await inputs(page)}`);
  await page.evaluate(() => globalThis.geofan.send({ type: "resolution", share: 1 }));
  console.log(`${name}, whole: ${await flight(page)}`);
}

/** Turns and flies through the table's region for some seconds, and tells the times between pictures. */
async function boxFlight(page, name, seconds = 12) {
  await page.evaluate(() => {
    const seen = (globalThis.seen = []);
    document.getElementById("picture").addEventListener("picture", () => seen.push(performance.now()));
  });
  // Turning all the time, so that there is something new to see at the region's edge too.
  await page.keyboard.down("ArrowRight");
  await page.keyboard.down("KeyW");
  let [looks, without, stoodIn] = [0, 0, 0];
  for (const end = performance.now() + 1e3 * seconds; performance.now() < end; looks += 1) {
    await page.waitForTimeout(250);
    const panel = await page.evaluate(() => globalThis.geofan.panel());
    without += !panel.within_table;
    stoodIn += panel.decoding;
  }
  await page.keyboard.up("KeyW");
  await page.keyboard.up("ArrowRight");
  const seen = await page.evaluate(() => globalThis.seen);
  const waits = seen.slice(1).map((at, i) => at - seen[i]).sort((a, b) => a - b);
  const at = (share) => waits[Math.floor(share * (waits.length - 1))]?.toFixed(0);
  const late = waits.filter((wait) => wait > 50).length;
  console.log(`${name}: ${seen.length} pictures in ${seconds} s, between them ${at(0.5)} ms (median; 95 %: ${at(0.95)}, longest ${at(1)}), ${late} times over 50 ms; of ${looks} looks ${stoodIn} at exact paths that stood in for the table, ${without} outside of it`);
}

/** Resident bytes of the largest renderer process of the browser: that of the page, as others wait for pages. */
function rendererMemory() {
  let most = 0;
  for (const pid of readdirSync("/proc").filter((name) => /^\d+$/.test(name))) {
    try {
      if (!readFileSync(`/proc/${pid}/cmdline`, "utf8").includes("--type=renderer")) continue;
      most = Math.max(most, Number(/Pss:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/smaps_rollup`, "utf8"))[1]) * 1024);
    } catch {
      // It has ended meanwhile.
    }
  }
  return most;
}

/** Bytes of the memories of the page's workers, MB. */
const workerMemories = (page) => Promise.all(page.workers().map((worker) =>
  worker.evaluate(() => Math.round(calls.memory.buffer.byteLength / 1e6))));

/** Random numbers that a seed gives (xorshift). */
function stream(seed) {
  let state = (Number(seed) * 2654435761) >>> 0 || 1;
  return () => {
    state ^= state << 13; state >>>= 0;
    state ^= state >>> 17;
    state ^= state << 5; state >>>= 0;
    return state / 2 ** 32;
  };
}

async function soak(browser, address) {
  const empty = await (await browser.newContext()).newPage();
  await empty.goto("about:blank");
  const blank = rendererMemory();
  const { page, errors } = await open(browser, address);
  const random = stream(seed);
  const keys = ["KeyW", "KeyS", "KeyA", "KeyD", "KeyQ", "KeyE", "KeyZ", "KeyC", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"];
  const once = ["KeyX", "KeyV", "KeyM", "KeyG", "KeyH", "KeyT", "Escape", "KeyB", "BracketLeft", "BracketRight", "KeyO", "Enter", "Minus", "Equal"];
  const end = performance.now() + 60e3 * Number(minutes);
  const memory = [];
  // What a slider's value does that no space has is told in the window, and is no error of the page.
  const told = new Set();
  let [events, next] = [0, 0];
  while (performance.now() < end) {
    const pick = (list) => list[Math.floor(random() * list.length)];
    const kind = random();
    if (kind < 0.4) {
      const key = pick(keys);
      await page.keyboard.down(key);
      await page.waitForTimeout(random() * 300);
      await page.keyboard.up(key);
    } else if (kind < 0.6) await page.keyboard.press(pick(once));
    else if (kind < 0.75) await page.mouse.click(640 * random(), 360 * random());
    else if (kind < 0.9) {
      await page.mouse.move(640 * random(), 360 * random());
      await page.mouse.down();
      await page.mouse.move(640 * random(), 360 * random(), { steps: 4 });
      await page.mouse.up();
    } else if (kind < 0.95) await page.mouse.wheel(0, random() < 0.5 ? -120 : 120);
    else await page.setViewportSize({ width: 600 + Math.floor(500 * random()), height: 300 + Math.floor(300 * random()) });
    events += 1;
    if (performance.now() > next) {
      next = performance.now() + 15e3;
      memory.push(Math.round((rendererMemory() - blank) / 1e6));
      const panel = await page.evaluate(() => globalThis.geofan.panel());
      if (![...panel.pose.at, ...panel.pose.look, ...panel.pose.up].every(Number.isFinite)) errors.push("the camera is nowhere");
      if (panel.trouble) told.add(panel.trouble);
    }
  }
  console.log(`${events} random inputs in ${minutes} minutes (seed ${seed}): ${errors.length} errors; the page's memory above a blank one, MB: ${memory.join(" ")}; its workers' at last: ${(await workerMemories(page)).join(" ")}`);
  told.forEach((text) => console.log(`  told: ${text}`));
  errors.forEach((error) => console.log(`  ${error}`));
  return errors.length;
}

/** Starts the program's server for a scene with its table, and opens it. */
async function served(browser, scene, bundle) {
  const began = performance.now();
  const viewer = spawn(geofan, ["view", scene, "--bundle", bundle, "--no-open"]);
  const address = await new Promise((done) => viewer.stdout.on("data", (data) => done(String(data).trim())));
  const serving = performance.now() - began;
  const opened = await open(browser, address);
  return { ...opened, viewer, serving, ready: performance.now() - began };
}

async function opening(browser) {
  const native = await served(browser, scene, bundle);
  console.log(`native: serves after ${native.serving.toFixed(0)} ms, first picture ${native.ready.toFixed(0)} ms after the command`);
  await figures(native.page, "native");
  await native.page.close();
  native.viewer.kill();
  const address = pageOf("gallery", scene, bundle);
  for (const workers of [1, 2]) {
    const own = await open(browser, `${address}#workers=${workers}`);
    console.log(`page, ${workers} worker(s): first picture after ${own.ready.toFixed(0)} ms`);
    await figures(own.page, `page, ${workers} worker(s)`);
    await own.page.close();
  }
}

async function box(browser) {
  const native = await served(browser, boxScene, boxBundle);
  await boxFlight(native.page, "box, native");
  await native.page.close();
  native.viewer.kill();
  const own = await open(browser, `${pageOf("box", boxScene, boxBundle)}#workers=2`);
  await boxFlight(own.page, "box, page, 2 workers");
  await own.page.close();
}

let wrong = 0;
const browser = await chromium.launch({ executablePath: browserPath, args: flags });
const only = process.env.ONLY;
try {
  if (!only || only === "opening") await opening(browser);
  if (!only || only === "box") await box(browser);
  if (Number(minutes) > 0 && (!only || only === "random")) wrong = await soak(browser, pageOf("random input", scene, bundle));
} finally {
  await browser.close();
}
process.exit(wrong ? 1 : 0);
