// An experiment with episodes: its runs over time, together and separately, and the lengths of its answers.
import assert from "node:assert/strict";
import { describe, test } from "node:test";
import { waitForCharts, open, horizontalOverflow } from "./browser.mjs";
import { base, browser, pages } from "./dashboard.mjs";

describe("runs over time", () => {
  for (const script of [true, false]) {
    for (const width of [320, 1300]) {
      test(`runs of an experiment show their episodes: ${width} px, ${script ? "with" : "without"} script`, async () => {
        const { page, errors, close } = await open(browser, base, pages.experiment, { width, script });
        const panel = page.getByRole("region", { name: "Over time" }), runs = panel.locator("figure");
        assert.equal(await runs.count(), 2);
        for (const run of await runs.all()) {
          assert.match(await run.locator("figcaption").innerText(), /^(local|cloud) #\d+ 3 episodes of 40 steps began/);
          const path = (name) => run.locator(`path.${name}`).getAttribute("d");
          assert.equal((await path("border")).match(/M/g).length, 2, "the first episode has no border");
          assert.match(await path("median"), /^M[\d.]+ [\d.]+L/);
          assert.ok((await run.locator(".sheet path[class^=f-]").count()) > 1, "stages are stacked");
          const [inner, outer] = await Promise.all([run.locator(".plot").boundingBox(), panel.boundingBox()]);
          assert.ok(inner.width > 150 && inner.height > 60 && inner.x >= outer.x && inner.x + inner.width <= outer.x + outer.width, JSON.stringify({ inner, outer }));
        }
        const lengths = page.getByRole("region", { name: "Response length against latency" });
        assert.match(await lengths.locator("figcaption").innerText(), /^(local|cloud)/);
        const [plot, around] = await Promise.all([lengths.locator("svg").first().boundingBox(), lengths.boundingBox()]);
        assert.ok(plot.x >= around.x && plot.x + plot.width <= around.x + around.width, JSON.stringify({ plot, around }));
        assert.ok((await horizontalOverflow(page)) <= 0, "the page does not scroll sideways");
        await runs.first().locator("figcaption a").click();
        await page.waitForURL("**/runs/*#course");
        const course = page.locator("#course");
        assert.match(await course.locator(".sub").innerText(), /^3 episodes of 40 steps began/);
        if (script) {
          await waitForCharts(page);
          const marks = await page.evaluate(() => globalThis.echarts.getInstanceByDom(document.getElementById("run-chart")).getOption().series.find((one) => one.name === "run-marks").data);
          // Two marks are periods of warm-up: the first episode with the first step of the second, and the first step
          // of the third. The other two are the borders of the episodes; each begins and ends at the same time.
          assert.equal(marks.filter(([from, to]) => from === to).length, 2);
          assert.equal(marks.length, 4);
        } else {
          assert.ok(await course.locator("table").isVisible());
        }
        assert.deepEqual(errors, []);
        await close();
      });
    }
  }
});
