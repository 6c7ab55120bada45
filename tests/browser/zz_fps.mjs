import { chromium } from "playwright-core";
const pages = process.argv.slice(3), rounds = Number(process.argv[2]);
const flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];
const middle = (list) => [...list].sort((a, b) => a - b)[list.length >> 1];
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: flags });
for (let r = 0; r < rounds; r++) for (const p of pages) {
  const ctx = await browser.newContext({ viewport: { width: 930, height: 360 } });
  const page = await ctx.newPage();
  const began = performance.now();
  await page.goto("file://" + p);
  await page.waitForFunction(() => globalThis.geofan?.stats().frames > 0, null, { timeout: 60000, polling: 5 });
  const ready = performance.now() - began;
  await page.waitForTimeout(1500);
  await page.evaluate(() => globalThis.geofan.send({ type: "resolution", share: 1 }));
  const fly = async (n) => {
    await page.keyboard.down("KeyA"); const seen = [];
    for (let i = 0; i < n; i++) { await page.waitForTimeout(100); const panel = await page.evaluate(() => globalThis.geofan.panel());
      if (i > n / 4 && panel.rate) seen.push([panel.rate, panel.size[0], panel.seconds]);
      if (i === n >> 1) { await page.keyboard.up("KeyA"); await page.keyboard.down("KeyD"); } }
    await page.keyboard.up("KeyD");
    return [0, 1, 2].map((k) => middle(seen.map((x) => x[k])));
  };
  const t = await fly(60);
  await page.keyboard.press("KeyX");
  const e = await fly(60);
  console.log(p, "ready", ready.toFixed(0), "table", t.map((x) => x?.toFixed(3)).join(" "), "exact", e.map((x) => x?.toFixed(3)).join(" "));
  await ctx.close();
}
await browser.close();
