// Navigation from page to page, and agreement of charts and tables.
import assert from "node:assert/strict";
import { describe, test } from "node:test";
import { openWithData, waitForCharts, waitForUpdate, open } from "./browser.mjs";
import { base, browser, newestRunNumbers, pages } from "./dashboard.mjs";

describe("navigation", () => {
  test("figures are updated, a run and its slowest iteration open", async () => {
    const { page, errors, close } = await open(browser, base, "/");
    await waitForCharts(page);
    await waitForUpdate(page, "#part-now");
    await page.getByRole("navigation", { name: "Pages" }).getByRole("link", { name: "Runs" }).click();
    await page.waitForURL("**/runs");
    await page.locator(`a[href="${pages.run}"]`).first().click();
    await page.waitForURL(`**${pages.run}`);
    await waitForCharts(page);
    await page.locator(".slow tbody tr:first-child a").click();
    await page.waitForURL("**/iterations/*");
    assert.match(await page.locator("h1").innerText(), /ms|s$/);
    assert.ok((await page.locator(".wf tbody tr").count()) > 5, "the waterfall has rows");
    assert.deepEqual(errors, []);
    await close();
  });

  test("stage row selects its distribution in place", async () => {
    const { page, errors, close } = await open(browser, base, pages.run);
    await page.evaluate(() => { window.same = true; });
    await page.locator("a.pick", { hasText: "inference" }).click();
    await page.waitForFunction(() => document.getElementById("di-h").textContent.includes("inference"));
    await page.locator("#distribution a", { hasText: "Cumulative" }).click();
    await page.waitForFunction(() => document.querySelector("#distribution .above").textContent.includes("%"));
    assert.equal(await page.evaluate(() => window.same), true);
    assert.match(page.url(), /stage=inference/);
    assert.deepEqual(errors, []);
    await close();
  });

  test("chart has a table view and can show one stage", async () => {
    const { page, errors, close } = await open(browser, base, "/");
    await waitForCharts(page);
    const card = page.locator(".card").first();
    await card.getByRole("button", { name: "Table" }).click();
    assert.ok(await card.locator("table").isVisible());
    await card.getByRole("button", { name: "Table" }).click();
    assert.ok(await card.locator(".chart").isVisible());
    await card.locator(".chart").hover();
    await page.locator(".tip:visible").waitFor();
    await waitForUpdate(page, "#part-now");
    assert.ok(await page.locator(".tip").first().isVisible(), "an open tooltip stays while figures change");
    await page.mouse.move(0, 0);
    const key = page.locator("#key button", { hasText: "inference" });
    await key.click();
    assert.equal(await page.locator("#key button[aria-pressed=true]").count(), 1);
    await key.click();
    assert.equal(await page.locator("#key button[aria-pressed=false]").count(), 0);
    await page.getByRole("button", { name: "Table" }).first().click();
    assert.ok(await page.locator("#part-nowtable").isVisible());
    assert.deepEqual(errors, []);
    await close();
  });
});

describe("charts of few data", () => {
  // Opens the overview after `change` has replaced the data of its first chart, without later updates. Returns
  // functions for the points of a series: `all`, and `of`, which omits points without a value.
  async function openFirstChart(change, options) {
    const { page, errors, close } = await openWithData(browser, base, "/", (data) => change(data.charts[0]), options);
    const series = await page.evaluate(() => {
      const all = globalThis.echarts.getInstanceByDom(document.querySelector(".live-chart")).getOption().series;
      return all.map(({ name, data }) => ({ name, data: (data || []).map((point) => ({ value: point.value?.[1] ?? point[1] ?? null, at: (point.value ?? point)[0], symbol: point.symbol ?? null })) }));
    });
    await close();
    return { errors, of: (name) => series.find((one) => one.name.startsWith(name)).data.filter((point) => point.value != null), all: (name) => series.find((one) => one.name.startsWith(name)).data };
  }

  test("run of one second is a visible area and a dot", async () => {
    const { of } = await openFirstChart((chart) => Object.assign(chart, { remote: true, n: [32], p95: { size: 1, points: [[chart.from, 9]] }, means: { total: [8], inference: [5] }, transfers: { up: [[3e6, 1e6]], down: [null] }, obstacles: [null, null], cpu: [], gpu: [] }));
    assert.equal(of("inference").length, 2);
    assert.deepEqual(of("p95").map(({ value }) => value), [9, 9]);
    assert.deepEqual(of("strip 0").map(({ value, symbol }) => [value, symbol]), [[3, "circle"]]);
  });

  // Ten minutes at 2 Hz with one iteration of 1.4 s, so that the mean of its second is 705 ms. A
  // minute has 120 iterations, and a shorter bucket has too few for a percentile. The fourth minute
  // has no percentile. The ten minutes end after the data of all other charts, so that they
  // determine the time range.
  const slow = (chart) => {
    const from = (Math.floor(chart.from / 60) + 1) * 60, seconds = Array.from({ length: 600 }, (_, at) => at);
    const total = seconds.map((at) => (at === 333 ? 705 : 10)), points = [0, 60, 120, 240, 300, 360, 420, 480, 540].map((at) => [from + at, 11]);
    Object.assign(chart, { from, remote: false, n: seconds.map(() => 2), means: { total, inference: total }, transfers: { up: seconds.map(() => null), down: seconds.map(() => null) }, p95: { size: 60, points }, cpu: [], gpu: [] });
  };
  test("percentiles and means do not depend on the width", async () => {
    const drawings = [];
    for (const width of [400, 1440, 2560]) {
      const { all } = await openFirstChart(slow, { width });
      drawings.push({ p95: all("p95"), inference: all("inference") });
    }
    assert.deepEqual(drawings[0], drawings[1]);
    assert.deepEqual(drawings[1], drawings[2]);
    const { p95 } = drawings[0], values = p95.map(({ value }) => value);
    assert.equal(Math.max(...values), 11, "no mean of percentiles of fewer iterations");
    assert.equal(values.filter((value) => value == null).length, 1, "the line stops where a bucket has no percentile");
    // Each of the nine percentiles is drawn from the start to the end of its minute, and the gap is
    // one more point.
    assert.deepEqual([p95[1].at - p95[0].at, values.length], [60e3, 19]);
  });

  test("CPU line is interrupted without reports", async () => {
    const { all } = await openFirstChart((chart) => {
      const from = chart.from;
      Object.assign(chart, { remote: false, cpu: [[from, 90], [from + 5, 100], [from + 500, 100], [from + 505, 80]], gpu: [] });
    });
    assert.deepEqual(all("strip 0").map(({ value }) => value), [90, 100, null, 100, 80]);
  });

  test("chart shows new data after a step of the clock", async () => {
    let shown;
    // Both charts end far from the data of all other charts, so that only these two can determine the time range.
    const { page, close } = await openWithData(browser, base, "/", ({ charts }) => {
      shown = charts.slice(0, 2);
      const from = charts[0].from + 1e6, list = (value) => Array(600).fill(value);
      for (const chart of shown) Object.assign(chart, { from, remote: false, n: list(2), means: { total: list(10), inference: list(10) }, transfers: { up: list(null), down: list(null) }, p95: { size: null, points: [] }, cpu: [], gpu: [] });
    });
    assert.equal(shown.length, 2);
    let last = shown[0].from + 599;
    // The clock of the first chart's host is set by `step` seconds; the clock of the other host is right.
    for (const step of [-86400, 1e9]) {
      last += 1;
      const lasts = [last + step, last];
      await page.evaluate(([charts, lasts]) => {
        const second = (at) => ({ at, counts: { ok: 2 }, parts: { inference: 0.01 }, means: { total: 0.01 }, transfers: { upload: null, download: null } });
        const pipelines = charts.map(({ host, pipeline }, index) => ({ host, name: pipeline, seconds: [second(lasts[index] - 1), second(lasts[index])], total_over_time: { bucket_s: null, points: [] } }));
        document.dispatchEvent(new CustomEvent("peernet-picture", { detail: { at: new Date().toISOString(), hosts: [], pipelines } }));
        // A choice of the range draws at once.
        document.dispatchEvent(new CustomEvent("peernet-range", { detail: 600 }));
      }, [shown, lasts]);
      await page.waitForFunction(([charts, lasts]) => charts.every(({ key }, index) => {
        const { xAxis, series } = globalThis.echarts.getInstanceByDom(document.querySelector(`.live-chart[data-key="${CSS.escape(key)}"]`)).getOption();
        const end = (lasts[index] + 1) * 1000, points = series.find(({ name }) => name === "inference").data;
        return xAxis[0].max === end && points.some((point) => (point.value ?? point)[1] != null && Math.abs((point.value ?? point)[0] - end) < 60e3);
      }), [shown, lasts], { timeout: 30000 });
    }
    await close();
  });
});

describe("trust and comparison of runs", () => {
  test("run page shows its trust verdict as word and sign", async () => {
    const { page, errors, close } = await open(browser, base, pages.run);
    const trust = page.locator("#trust");
    assert.match(await trust.innerText(), /Can this run be published\?[\s\S]*(Yes|No)[:,]/);
    assert.ok((await trust.locator(".chip svg").count()) > 0);
    await trust.locator("summary").click();
    assert.match(await trust.innerText(), /iterations? succeeded/);
    const { verdict, answer } = await (await fetch(`${base}/api/v1${pages.run}/trust`)).json();
    assert.ok(["yes", "with-remarks", "no"].includes(verdict));
    assert.ok((await trust.innerText()).includes(answer.split(":")[0]));
    assert.deepEqual(errors, []);
    await close();
  });

  test("selected runs are compared, with and without script", async () => {
    for (const script of [true, false]) {
      const { page, errors, close } = await open(browser, base, "/runs", { script });
      const numbers = await newestRunNumbers();
      for (const number of numbers) await page.locator(`input[name=runs][value="${number}"]`).check();
      await page.getByRole("button", { name: "Compare chosen" }).click();
      await page.waitForURL("**/compare?runs=*");
      assert.equal(await page.locator(".compare tbody tr").count(), numbers.length);
      assert.ok((await page.locator(".bars svg.stages[role=img]").count()) >= numbers.length);
      assert.match(await page.locator("h1").innerText(), /smallest mean|smaller mean|less than|do not differ/);
      await page.locator(".compare tbody a").first().click();
      await page.waitForURL("**/runs/*");
      assert.deepEqual(errors, []);
      await close();
    }
  });
});

describe("clocks", () => {
  test("link chart is updated and agrees with its table", async () => {
    const { page, errors, close } = await open(browser, base, "/links");
    await page.locator("#part-list tbody a").first().click();
    await page.waitForURL("**/links/*~*");
    await page.locator(".tracks .band").first().waitFor({ state: "attached" });
    assert.match(await page.locator("h1").innerText(), /±|one clock|never related/);
    const band = () => page.locator(".tracks .band").first().getAttribute("d");
    const before = await band();
    await page.waitForFunction((path) => document.querySelector(".tracks .band")?.getAttribute("d") !== path, before, { timeout: 30000 });
    await page.getByRole("button", { name: "Table" }).click();
    assert.ok(await page.locator("#part-table table").isVisible());
    assert.equal(await page.locator("#part-chart").isVisible(), false);
    await waitForUpdate(page, "#part-table");
    await page.getByRole("button", { name: "Table" }).click();
    assert.ok(await page.locator("#part-chart .tracks").isVisible());
    await page.getByRole("link", { name: "as measured" }).click();
    await page.waitForURL("**offset=measured");
    assert.ok((await page.locator(".tracks").first().getAttribute("aria-label")).includes("The offset was known to"));
    assert.deepEqual(errors, []);
    await close();
  });

  test("clock fault is shown on every page and does not affect delays", async () => {
    for (const [name, path] of Object.entries(pages)) {
      const { page, close } = await open(browser, base, path);
      assert.match(await page.locator("#clock-fault").innerText(), /^Clock fault injection: edge's clock is made wrong on purpose/, name);
      await close();
    }
    const link = await (await fetch(`${base}/api/v1${pages.link}`)).json();
    assert.ok(Math.abs(link.now.offset.estimate_s + 1) < 0.1, `the cloud is a second behind: ${link.now.offset.estimate_s}`);
    assert.ok(link.now.up.median.value_s < 0.5, "an upload on one machine takes no second");
    const { page, close } = await open(browser, base, pages.runs);
    assert.ok((await page.locator(".runs tbody tr .chip", { hasText: "clock fault" }).count()) > 0, "its runs are marked in their list");
    await close();
  });

  test("verdicts and long host names are visible on small screens", async () => {
    const phone = await open(browser, base, pages.iteration, { width: 400, height: 800 });
    const box = phone.page.getByRole("group", { name: "One-way delays" });
    assert.match(await box.innerText(), /low[\s\S]*high[\s\S]*verdict/);
    assert.ok(await box.evaluate((one) => one.scrollWidth <= one.clientWidth), "no column is hidden to the right");
    await phone.close();

    for (const [path, table] of [["/", "#part-hosts"], ["/hosts", "#part-list"], ["/hosts", "#part-events .scroll"], ["/incidents", "#incident-list"], [pages.host, "#part-pipelines"]]) {
      const { page, close } = await open(browser, base, path, { width: 400, height: 800 });
      const hidden = await page.locator(table).evaluate((one) => one.scrollWidth - one.clientWidth);
      assert.ok(hidden <= 0, `${table} of ${path} hides ${hidden} px to the right`);
      await close();
    }

    const screen = await open(browser, base, "/");
    const hosts = screen.page.locator("#part-hosts");
    await hosts.locator("tbody th a").first().evaluate((link) => { link.textContent = "edge-with-a-wrong-clock-and-a-long-name"; });
    assert.ok(await hosts.evaluate((one) => one.scrollWidth <= one.clientWidth), "no column of the hosts is hidden to the right");
    await screen.close();
  });
});
