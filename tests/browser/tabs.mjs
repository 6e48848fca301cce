// Many tabs of one browser: hidden tabs must hold no connection, because a browser opens at most six
// to a server.
import assert from "node:assert/strict";
import { describe, test } from "node:test";
import { waitForUpdate } from "./browser.mjs";
import { base, browser } from "./dashboard.mjs";

const TABS = 10;

// Simulates hidden tabs, because a headless browser treats all its pages as visible.
function simulateVisibility() {
  let hidden = false;
  Object.defineProperty(Document.prototype, "hidden", { get: () => hidden });
  Object.defineProperty(Document.prototype, "visibilityState", { get: () => (hidden ? "hidden" : "visible") });
  globalThis.setHidden = (isHidden) => {
    hidden = isHidden;
    document.dispatchEvent(new Event("visibilitychange"));
  };
  globalThis.streams = [];
  globalThis.EventSource = class extends EventSource {
    constructor(...args) {
      super(...args);
      globalThis.streams.push(this);
    }
  };
  // First and last second of the first pipeline in each live event since the page was shown.
  globalThis.seen = [];
  document.addEventListener("peernet-picture", ({ detail }) => {
    const seconds = detail.pipelines[0]?.seconds ?? [];
    if (seconds.length) globalThis.seen.push([seconds[0].at, seconds[seconds.length - 1].at]);
  });
}
const openStreams = (page) => page.evaluate(() => globalThis.streams.filter((one) => one.readyState !== EventSource.CLOSED).length);
const hide = (page) => page.evaluate(() => globalThis.setHidden(true));
const show = (page) => page.evaluate(() => { globalThis.seen = []; globalThis.setHidden(false); });

describe("many tabs", () => {
  test("hidden tabs hold no connection and are current when shown", async () => {
    const context = await browser.newContext({ baseURL: base });
    await context.addInitScript(simulateVisibility);
    const tabs = [];
    for (let count = 0; count < TABS; count++) {
      const page = await context.newPage();
      await page.goto("/", { timeout: 10000 });
      await waitForUpdate(page, "#part-now");
      assert.equal(await openStreams(page), 1, `tab ${count + 1} is live`);
      tabs.push(page);
      if (count < TABS - 1) await hide(page);
    }
    assert.deepEqual(await Promise.all(tabs.map(openStreams)), [...Array(TABS - 1).fill(0), 1]);

    const [first] = tabs, last = tabs[TABS - 1];
    const until = await first.evaluate(() => globalThis.seen.at(-1)[1]);
    // Longer than the seconds that each live event contains.
    await last.waitForFunction((at) => globalThis.seen.at(-1)[1] > at + 8, until, { timeout: 30000 });
    await hide(last);
    await show(first);
    await first.waitForFunction(() => globalThis.seen.length > 0);
    const [from, to] = await first.evaluate(() => globalThis.seen[0]);
    assert.ok(from <= until + 1 && to > until + 8, `had ${until}, got ${from} to ${to}`);
    await waitForUpdate(first, "#part-now");
    assert.deepEqual([await openStreams(first), await openStreams(last)], [1, 0]);
    assert.equal(await first.locator("#banner").isVisible(), false);
    await context.close();
  });
});
