// The viewer in a real browser, by the program's engine and as a page opened from its file alike: a flight through
// the throat and back, exact paths, the split screen, the error, a followed path, a broken and mended scene file,
// a saved picture, a replayed way; and the page by touch on a phone's screen. Screenshots are left in OUT.
//
//   cd tests/browser && npm install && node run.mjs GEOFAN SCENE BUNDLE OUT [chromium]
//
// GEOFAN is the program; its geofan-web.wasm must lie beside it (.ci/page.sh). Ends with 1 if something is wrong.

import { chromium } from "playwright-core";
import { spawn, execFileSync } from "node:child_process";
import { copyFileSync, cpSync, mkdirSync, readFileSync, statSync, writeFileSync, mkdtempSync } from "node:fs";
import { tmpdir } from "node:os";
import path from "node:path";

const [geofan, scene, bundle, out, browserPath = "/usr/bin/chromium"] = process.argv.slice(2);
if (!out) {
  console.error("usage: node run.mjs GEOFAN SCENE BUNDLE OUT [chromium]");
  process.exit(2);
}
mkdirSync(out, { recursive: true });
const work = mkdtempSync(path.join(tmpdir(), "geofan-browser-"));
// A copy of the scene's folders, because the test breaks its file.
cpSync(path.resolve(path.dirname(scene), ".."), path.join(work, "assets"), { recursive: true });
const copy = path.join(work, "assets", path.basename(path.dirname(scene)), path.basename(scene));
copyFileSync(bundle, path.join(work, "b.fan"));
let wrong = 0;

/** The display is 640 wide, beside the settings: in a lower window they are folded. */
const VIEWPORT = { width: 930, height: 482 };

function check(holds, words) {
  console.log(`${holds ? "ok   " : "WRONG"} ${words}`);
  if (!holds) wrong += 1;
}

const flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
  "--disable-background-networking", "--disable-component-update", "--disable-sync"];

async function open(address, context) {
  const began = performance.now();
  const page = await context.newPage();
  const asked = [];
  page.on("request", (request) => asked.push(request.url()));
  page.on("console", (message) => message.type() === "error" && console.log(`      console: ${message.text()}`));
  page.on("pageerror", (error) => { check(false, `no error in the page: ${error.message}`); });
  await page.goto(address);
  await page.waitForFunction(() => globalThis.geofan?.stats().frames > 0, null, { timeout: 60000 });
  const ready = performance.now() - began;
  return { page, ready, asked };
}

const panel = (page) => page.evaluate(() => globalThis.geofan.panel());
const until = (page, test, argument = null, timeout = 60000) =>
  page.waitForFunction(test, argument, { timeout, polling: 50 });
const shot = (page, name) => page.screenshot({ path: path.join(out, `${name}.png`) });

/** The picture's own pixels, 32 × 18 of them, to see whether it has changed and is not empty. */
const thumbnail = (page) => page.evaluate(() => {
  const small = Object.assign(document.createElement("canvas"), { width: 32, height: 18 });
  const paper = small.getContext("2d");
  paper.drawImage(document.getElementById("picture"), 0, 0, 32, 18);
  return [...paper.getImageData(0, 0, 32, 18).data];
});
const difference = (a, b) => a.reduce((sum, x, i) => sum + Math.abs(x - b[i]), 0) / a.length;
/** Waits until nothing is left to be refined; with few samples, because exact paths take their time. */
const SAMPLES = 4;
const settled = async (page) => {
  await page.evaluate((samples) => globalThis.geofan.send({ type: "still", samples }), SAMPLES);
  await page.waitForTimeout(300);
  return until(page, () => globalThis.geofan.panel()?.settled, null, 300000);
};

/** The session that both engines go through. */
async function session(page, name) {
  await settled(page);
  const start = await thumbnail(page);
  await shot(page, `${name}-1-start`);
  check(Math.max(...start.filter((_, i) => i % 4 !== 3)) > 60, `${name}: the picture is not dark`);
  const before = await panel(page);

  await page.keyboard.down("KeyW");
  const times = [];
  const through = async (sign) => {
    for (let i = 0; i < 120; i += 1) {
      await page.waitForTimeout(100);
      const now = await panel(page);
      if (now.rate) times.push([now.rate, now.seconds, now.size[0]]);
      const radius = Math.hypot(...now.pose.at);
      if (sign * (radius - 0.5) > 0.2 || now.hint) return now;
    }
    return panel(page);
  };
  const beyond = await through(-1);
  await page.keyboard.up("KeyW");
  check(Math.hypot(...beyond.pose.at) < 0.5, `${name}: flies through the throat, radius ${Math.hypot(...beyond.pose.at).toFixed(3)}`);
  await shot(page, `${name}-2-beyond`);
  const middle = (k) => times.map((t) => t[k]).sort((a, b) => a - b)[times.length >> 1];
  console.log(`      ${name}: moving, median ${middle(0)?.toFixed(1)} frames a second, ${(1e3 * middle(1)).toFixed(0)} ms each, ${middle(2)} wide`);
  await page.keyboard.press("KeyH");
  await settled(page);
  check(difference(start, await thumbnail(page)) < 0.5, `${name}: home shows the first picture again`);

  await page.keyboard.press("KeyX");
  await until(page, () => globalThis.geofan.panel().kind === "exact");
  await settled(page);
  await shot(page, `${name}-3-exact`);
  const exact = difference(start, await thumbnail(page));
  check(exact < 2, `${name}: exact paths show the same, mean difference ${exact.toFixed(3)} code values`);
  await page.keyboard.press("KeyX");
  await until(page, () => globalThis.geofan.panel().kind === "table");
  await page.keyboard.press("KeyV");
  await until(page, () => globalThis.geofan.panel().split === "exact");
  await settled(page);
  await shot(page, `${name}-4-split`);
  await page.keyboard.press("KeyV");
  await page.keyboard.press("KeyM");
  await until(page, () => globalThis.geofan.panel().errors);
  await shot(page, `${name}-5-error`);
  const errors = (await panel(page)).errors[0];
  check(errors.p99 < 5 && errors.p99 > 0, `${name}: errors are told, p99 ${errors.p99.toFixed(3)} mrad`);
  await page.keyboard.press("KeyM");
  await until(page, () => globalThis.geofan.panel().kind === "table");
  // Between two panels, which tell what holds.
  await page.keyboard.press("KeyV");
  await page.keyboard.press("KeyV");
  await page.waitForTimeout(500);
  check((await panel(page)).split === null, `${name}: a key pressed twice at once does and undoes`);
  await page.keyboard.press("KeyG");
  await until(page, () => globalThis.geofan.panel().kind === "flat");
  await settled(page);
  await shot(page, `${name}-6-flat`);
  check(difference(start, await thumbnail(page)) > 3, `${name}: flat space looks different`);
  await page.keyboard.press("KeyL");
  await until(page, () => globalThis.geofan.panel().hint?.includes("light is traced"));
  check(true, `${name}: where no light is traced a hint says so`);
  await page.keyboard.press("KeyL");
  await page.keyboard.press("KeyG");
  await until(page, () => globalThis.geofan.panel().kind === "table");

  const box = await page.locator("#picture").boundingBox();
  await page.mouse.click(box.x + 0.62 * box.width, box.y + 0.42 * box.height);
  await until(page, () => globalThis.geofan.panel().picked);
  await settled(page);
  await shot(page, `${name}-7-path`);
  await page.keyboard.press("KeyR");
  await page.keyboard.press("KeyT");
  await until(page, () => globalThis.geofan.panel().travelling);
  await page.waitForTimeout(1500);
  await page.keyboard.press("Escape");
  await page.waitForTimeout(1000);
  const end = (await panel(page)).pose.at;
  const download = page.waitForEvent("download");
  await page.keyboard.press("KeyR");
  const way = await download;
  await way.saveAs(path.join(work, `${name}-way.toml`));
  check(Math.hypot(...end.map((x, i) => x - before.pose.at[i])) > 1e-3, `${name}: follows a picked path`);
  await page.keyboard.press("KeyH");
  await page.keyboard.press("KeyP");
  await until(page, () => globalThis.geofan.panel().travelling);
  await until(page, () => !globalThis.geofan.panel().travelling);
  const again = (await panel(page)).pose.at;
  check(Math.hypot(...end.map((x, i) => x - again[i])) < 1e-3, `${name}: a replay ends where the recording did`);
  const frames = path.join(work, `${name}-%02d.png`);
  execFileSync(geofan, ["render", copy, "--bundle", path.join(work, "b.fan"), "--camera-path", path.join(work, `${name}-way.toml`), "--frames", "2", "--size", "64x36", "-o", frames, "--quiet"]);
  check(statSync(path.join(work, `${name}-01.png`)).size > 100, `${name}: geofan render takes the recorded way`);

  const picture = page.waitForEvent("download", { timeout: 120000 });
  await page.keyboard.press("KeyK");
  await (await picture).saveAs(path.join(out, `${name}-8-saved.png`));
  check(statSync(path.join(out, `${name}-8-saved.png`)).size > 10000, `${name}: a picture is saved`);
  // Linear light at a size of its own, read again by the program as a sky.
  await page.locator("summary", { hasText: "Picture to save" }).click();
  await page.getByLabel("Width of the saved picture").fill("128");
  await page.getByLabel("Height of the saved picture").fill("64");
  await page.getByLabel("Samples of the saved picture").selectOption("1");
  await page.getByLabel("Format of the saved picture").selectOption("EXR");
  const light = page.waitForEvent("download", { timeout: 120000 });
  await page.getByRole("button", { name: "Save picture" }).click();
  await (await light).saveAs(path.join(path.dirname(copy), `${name}-light.exr`));
  const lit = path.join(path.dirname(copy), `${name}-lit.toml`);
  writeFileSync(lit, readFileSync(copy, "utf8").replace(/^near = .*$/m, `near = { image = "${name}-light.exr" }`));
  execFileSync(geofan, ["render", lit, "--bundle", path.join(work, "b.fan"), "--size", "64x36", "-o", path.join(out, `${name}-lit.png`), "--quiet"]);
  check(statSync(path.join(out, `${name}-lit.png`)).size > 300, `${name}: the program reads the saved EXR file`);
  await page.locator("summary", { hasText: "Certificate" }).click();
  const certificate = page.waitForEvent("download");
  await page.getByText("Certificate as a file").focus();
  await page.keyboard.press("Enter");
  check(readFileSync(await (await certificate).path(), "utf8").includes("mrad"), `${name}: the certificate is linked`);
  const own = await thumbnail(page);
  await page.getByLabel("Skies").selectOption("stars");
  await until(page, () => globalThis.geofan.panel().sky === "stars");
  await settled(page);
  await shot(page, `${name}-9-stars`);
  check(difference(own, await thumbnail(page)) > 3, `${name}: other skies look different`);
  await page.getByLabel("Skies").selectOption("scene");
  await until(page, () => globalThis.geofan.panel().sky === "scene");
  await settled(page);
  check(difference(own, await thumbnail(page)) < 0.5, `${name}: the scene's own skies come back`);
  await traced(page, name);
  await page.locator("#picture").focus();
  const address = await page.evaluate(() => new Promise((done) => setTimeout(() => done(location.hash), 1500)));
  check(address.includes("at=") && address.includes("show="), `${name}: the address holds the settings`);
}

/** A key of any layout, by what it writes and where it lies; the driver knows the US layout only. */
const pressOther = (page, key, code, shiftKey = false) => page.evaluate((init) => {
  for (const type of ["keydown", "keyup"]) document.activeElement.dispatchEvent(new KeyboardEvent(type, init));
}, { key, code, shiftKey, bubbles: true, cancelable: true });

/** Keys of other layouts, the address, and what a screen reader is told. */
async function forAll(page, address, context) {
  await page.locator("#picture").focus();
  const before = await panel(page);
  for (const [layout, code] of [["German", "Minus"], ["French", "KeyM"], ["Russian", "Digit7"]]) {
    await pressOther(page, "?", code, true);
    const helps = await page.evaluate(() => {
      const help = document.getElementById("help");
      const { open } = help;
      help.close();
      return open;
    });
    check(helps, `native: a ${layout} question mark opens the help`);
  }
  await page.waitForTimeout(500);
  const after = await panel(page);
  check(after.speed === before.speed && after.kind === before.kind, "native: and does nothing else");
  for (const [layout, key, code] of [["Dvorak", "g", "KeyI"], ["Russian", "п", "KeyG"]]) {
    await pressOther(page, key, code);
    await until(page, () => globalThis.geofan.panel().kind === "flat");
    await pressOther(page, key, code);
    await until(page, (kind) => globalThis.geofan.panel().kind === kind, before.kind);
    check(true, `native: a ${layout} letter does what it names`);
  }
  await pressOther(page, "-", "Minus");
  await pressOther(page, "o", "KeyO");
  await until(page, (speed) => globalThis.geofan.panel().speed < speed, before.speed);
  const written = await page.evaluate(() => new Promise((done) => setTimeout(() => done(location.hash), 1500)));
  const other = await open(address + written, context);
  await until(other.page, (speed) => Math.abs(globalThis.geofan.panel().speed / speed - 1) < 1e-4, (await panel(page)).speed);
  const chosen = await other.page.evaluate(() => ["Width", "Height", "Samples", "Format"].map((word) => document.querySelector(`[aria-label="${word} of the saved picture"]`).value));
  check(chosen.join() === "128,64,1,EXR", `native: the picture to save is in the address, ${chosen}`);
  check(await other.page.locator("#overlay").textContent() === "", "native: so is whether the numbers are shown, and the speed");
  await other.page.evaluate(() => { location.hash = "at=1,2&show=nix&still=-2&fov=abc&exposure=1&set.nobody=1"; });
  await until(other.page, () => globalThis.geofan.panel().exposure === 1);
  const hint = await other.page.locator("#hint").textContent();
  check(["at", "show", "still", "fov", "set.nobody"].every((name) => hint.includes(name)) && !hint.includes("exposure"), `native: a hint names what means nothing in an address: ${hint}`);
  await other.page.close();
  await page.keyboard.press("KeyO");
  const live = await page.evaluate(() => {
    globalThis.written = 0;
    new MutationObserver((list) => { globalThis.written += list.length; }).observe(document.getElementById("hint"), { childList: true });
    return document.querySelector("output, #overlay:not([aria-live=off])");
  });
  await page.keyboard.down("ArrowRight");
  await page.waitForTimeout(1000);
  await page.keyboard.up("ArrowRight");
  check(live === null && await page.evaluate(() => globalThis.written) <= 1, "native: a screen reader is not told the numbers again and again");
  await page.evaluate(() => globalThis.geofan.send({ type: "pick", x: 0.5, y: 0.5 }));
  await until(page, () => !document.getElementById("map-box").hidden);
  const label = () => page.locator("#map").getAttribute("aria-label");
  const first = await label();
  await page.locator("#map").focus();
  await page.keyboard.press("Enter");
  check(await label() !== first, "native: Enter turns the map that has the focus");
  await page.locator("#picture").focus();
  await page.evaluate(() => { location.hash = "moving=0.7&paths=100"; });
  await until(page, () => globalThis.geofan.panel().passes[1] === 100);
  const lists = await page.evaluate(() => ["Resolution while it moves", "Path tracing"].map((word) => document.querySelector(`[aria-label="${word}"]`).selectedOptions[0]?.textContent));
  check(lists.join() === "70 % while it moves,Path tracing, 100 samples", `native: lists show what an address asks for: ${lists}`);
  await page.evaluate(() => { location.hash = "moving=0&paths=0"; });
  await until(page, () => globalThis.geofan.panel().passes[1] === 0);
  await wheelAndFile(page);
}

/** The wheel with Ctrl is the browser's, a trackpad's parts of a notch are parts of a step; a chosen file gives the keys back. */
async function wheelAndFile(page) {
  const turned = (deltaY, ctrlKey) => page.evaluate(([deltaY, ctrlKey]) => {
    const event = new WheelEvent("wheel", { deltaY, ctrlKey, cancelable: true });
    document.getElementById("picture").dispatchEvent(event);
    return event.defaultPrevented;
  }, [deltaY, ctrlKey]);
  const { speed } = await panel(page);
  const taken = [await turned(-100, true), await turned(-10, false)];
  await until(page, (speed) => globalThis.geofan.panel().speed > speed, speed);
  const factor = (await panel(page)).speed / speed;
  check(taken.join() === "false,true" && factor < 1.03, `native: the wheel, times ${factor.toFixed(3)} for a tenth of a notch`);
  const way = path.join(work, "way.toml");
  const pose = (time, { at, look, up }) => `[[pose]]\ntime = ${time}\nat = ${JSON.stringify(at)}\nlook = ${JSON.stringify(look)}\nup = ${JSON.stringify(up)}\n`;
  const before = (await panel(page)).pose;
  writeFileSync(way, pose(0, before) + pose(0.2, before));
  await page.locator("input[type=file]").focus();
  await page.locator("input[type=file]").setInputFiles(way);
  await page.waitForTimeout(1000);
  await page.keyboard.down("KeyS");
  await page.waitForTimeout(400);
  await page.keyboard.up("KeyS");
  const moved = (await panel(page)).pose.at;
  check(moved.some((x, i) => x !== before.at[i]), "native: after a file was chosen keys move the camera");
}

/** Light by path tracing takes the place of the refined picture; in a small window, because it takes its time. */
async function traced(page, name) {
  const before = page.viewportSize();
  await page.setViewportSize({ width: 300, height: 120 });
  await settled(page);
  const refined = await thumbnail(page);
  await page.evaluate(() => globalThis.geofan.send({ type: "paths", passes: 6 }));
  await until(page, () => globalThis.geofan.panel().settled && globalThis.geofan.panel().passes[0] === 6, null, 300000);
  await page.waitForTimeout(300);
  await shot(page, `${name}-10-traced`);
  const light = difference(refined, await thumbnail(page));
  check(light > 1, `${name}: traced light takes the place of the picture, mean difference ${light.toFixed(1)}`);
  await page.evaluate(() => globalThis.geofan.send({ type: "paths", passes: 0 }));
  await until(page, () => globalThis.geofan.panel().passes[1] === 0);
  await settled(page);
  check(difference(refined, await thumbnail(page)) < 0.5, `${name}: and gives it back`);
  await page.setViewportSize(before);
}

/** A worker that fails is told of, also after later panels, and the others draw on. */
async function withoutWorker(page) {
  const workers = page.workers();
  await workers[0].evaluate(() => postMessage({ broken: "a test" }));
  await until(page, () => document.getElementById("trouble").textContent.includes("a test"));
  if (workers.length > 1) {
    await page.evaluate(() => globalThis.geofan.send({ type: "home" }));
    await settled(page);
  }
  check(await page.locator("#trouble").isVisible(), `page: a worker that fails is told of, and ${workers.length - 1} draw on`);
}

let viewer = null;

async function native(browser) {
  viewer = spawn(geofan, ["view", copy, "--bundle", path.join(work, "b.fan"), "--no-open"]);
  const began = performance.now();
  const address = await new Promise((done) => viewer.stdout.on("data", (data) => done(String(data).trim())));
  const context = await browser.newContext({ viewport: VIEWPORT, acceptDownloads: true });
  const { page, ready, asked } = await open(address, context);
  console.log(`      native: ${(performance.now() - began).toFixed(0)} ms from the command to the first picture, ${ready.toFixed(0)} of them in the browser`);
  check(asked.every((url) => url.startsWith(new URL(address).origin) || url.startsWith("blob:")), "native: only its own server is asked");
  await session(page, "native");
  await forAll(page, address, context);

  const text = readFileSync(copy, "utf8");
  writeFileSync(copy, text.replace(/^look = .*$/m, "look = \"wide\""));
  await until(page, () => globalThis.geofan.panel().trouble);
  const trouble = (await panel(page)).trouble;
  check(trouble.includes(path.basename(copy)) && trouble.includes("wide"), "native: a mistake is shown with its line");
  await shot(page, "native-11-broken");
  await page.keyboard.press("Escape");
  await until(page, () => document.getElementById("trouble").hidden);
  writeFileSync(copy, text);
  await until(page, () => !globalThis.geofan.panel().trouble);
  check(true, "native: and goes when it is mended");
  await context.close();
  viewer.kill();
}

async function standalone(browser) {
  const file = path.join(work, "page.html");
  execFileSync(geofan, ["view", copy, "--bundle", path.join(work, "b.fan"), "--page", file]);
  console.log(`      page: ${(statSync(file).size / 1e6).toFixed(2)} MB`);
  const context = await browser.newContext({ viewport: VIEWPORT, acceptDownloads: true });
  const { page, ready, asked } = await open(`file://${file}`, context);
  console.log(`      page: first picture ${ready.toFixed(0)} ms after it is opened`);
  check(asked.every((url) => url === `file://${file}` || url.startsWith("blob:")), "page: nobody is asked for anything");
  await session(page, "page");
  await withoutWorker(page);
  await context.close();

  const phone = await browser.newContext({ viewport: { width: 390, height: 700 }, deviceScaleFactor: 2, hasTouch: true, isMobile: true });
  const small = await open(`file://${file}`, phone);
  const before = (await panel(small.page)).pose;
  await small.page.touchscreen.tap(150, 300);
  await until(small.page, () => globalThis.geofan.panel().picked);
  const client = await phone.newCDPSession(small.page);
  const touch = (type, points) => client.send("Input.dispatchTouchEvent", { type, touchPoints: points });
  await touch("touchStart", [{ x: 200, y: 250 }]);
  for (let i = 1; i <= 10; i += 1) await touch("touchMove", [{ x: 200 - 8 * i, y: 250 }]);
  await touch("touchEnd", []);
  await small.page.waitForTimeout(300);
  const after = (await panel(small.page)).pose;
  check(Math.hypot(...after.look.map((x, i) => x - before.look[i])) > 0.05, "phone: a finger turns the head");
  const button = await small.page.getByRole("button", { name: "Forwards" }).boundingBox();
  await touch("touchStart", [{ x: button.x + 20, y: button.y + 20 }]);
  await small.page.waitForTimeout(500);
  await touch("touchEnd", []);
  const moved = (await panel(small.page)).pose;
  check(Math.hypot(...moved.at.map((x, i) => x - after.at[i])) > 1e-3, "phone: the pad moves the camera");
  await small.page.evaluate(() => document.querySelector("#pad [aria-label=Forwards]").click());
  await small.page.waitForTimeout(500);
  const clicked = (await panel(small.page)).pose;
  check(Math.hypot(...clicked.at.map((x, i) => x - moved.at[i])) > 1e-4, "phone: so does a screen reader's click on it");
  const sides = await small.page.evaluate(() => { const map = document.getElementById("map"); return [map.width, map.clientWidth]; });
  check(sides[0] === 2 * sides[1], `phone: the map is as sharp as the screen, ${sides}`);
  await shot(small.page, "phone");
  await small.page.getByRole("button", { name: "Close the map" }).tap();
  await until(small.page, () => document.getElementById("map-box").hidden && !globalThis.geofan.panel().picked);
  const { speed } = await panel(small.page);
  await small.page.getByRole("button", { name: "Faster" }).tap();
  await until(small.page, (speed) => globalThis.geofan.panel().speed > speed, speed);
  check(true, "phone: buttons close the map and make the camera faster");
  await phone.close();
}

const browser = await chromium.launch({ executablePath: browserPath, args: flags });
try {
  if (!process.env.ONLY || process.env.ONLY === "native") await native(browser);
  if (!process.env.ONLY || process.env.ONLY === "page") await standalone(browser);
} finally {
  viewer?.kill();
  await browser.close();
}
console.log(wrong === 0 ? "all is well" : `${wrong} wrong`);
process.exit(wrong === 0 ? 0 : 1);
