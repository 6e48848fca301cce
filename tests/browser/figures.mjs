// What a person does to see figures: pages open one another, charts and tables show the same.
import assert from "node:assert/strict";
import { describe, test } from "node:test";
import { charted, drawn, moves, open } from "./browser.mjs";
import { base, browser, latest, pages } from "./dashboard.mjs";

describe("the way of a person", () => {
  test("figures move, a run opens, its slowest iteration opens", async () => {
    const { page, errors, close } = await open(browser, base, "/");
    await drawn(page);
    await moves(page, "#part-now");
    await page.getByRole("navigation", { name: "Pages" }).getByRole("link", { name: "Runs" }).click();
    await page.waitForURL("**/runs");
    await page.locator(`a[href="${pages.run}"]`).first().click();
    await page.waitForURL(`**${pages.run}`);
    await drawn(page);
    await page.locator(".slow tbody tr:first-child a").click();
    await page.waitForURL("**/iterations/*");
    assert.match(await page.locator("h1").innerText(), /ms|s$/);
    assert.ok((await page.locator(".wf tbody tr").count()) > 5, "the waterfall has rows");
    assert.deepEqual(errors, []);
    await close();
  });

  test("a row of the stage table shows its distribution without a new page", async () => {
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

  test("a chart flips to its table and back, one stage can be shown alone", async () => {
    const { page, errors, close } = await open(browser, base, "/");
    await drawn(page);
    const card = page.locator(".card").first();
    await card.getByRole("button", { name: "Table" }).click();
    assert.ok(await card.locator("table").isVisible());
    await card.getByRole("button", { name: "Table" }).click();
    assert.ok(await card.locator(".chart").isVisible());
    await card.locator(".chart").hover();
    await page.locator(".tip:visible").waitFor();
    await moves(page, "#part-now");
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

describe("what is drawn of little", () => {
  // The overview with these seconds in its first chart, and nothing that comes later.
  async function first(change, options) {
    const { page, errors, close } = await charted(browser, base, "/", (data) => change(data.charts[0]), options);
    const series = await page.evaluate(() => {
      const all = globalThis.echarts.getInstanceByDom(document.querySelector(".live-chart")).getOption().series;
      return all.map(({ name, data }) => ({ name, data: (data || []).map((point) => ({ value: point.value?.[1] ?? point[1] ?? null, at: (point.value ?? point)[0], symbol: point.symbol ?? null })) }));
    });
    await close();
    return { errors, of: (name) => series.find((one) => one.name.startsWith(name)).data.filter((point) => point.value != null), all: (name) => series.find((one) => one.name.startsWith(name)).data };
  }

  test("a run of one second is seen: an area as wide as its bucket and a dot", async () => {
    const { of } = await first((chart) => Object.assign(chart, { remote: true, n: [32], p95: { size: 1, points: [[chart.from, 9]] }, means: { total: [8], inference: [5] }, transfers: { up: [[3e6, 1e6]], down: [null] }, obstacles: [null, null], cpu: [], gpu: [] }));
    assert.equal(of("inference").length, 2);
    assert.deepEqual(of("p95").map(({ value }) => value), [9, 9]);
    assert.deepEqual(of("strip 0").map(({ value, symbol }) => [value, symbol]), [[3, "circle"]]);
  });

  // Ten minutes at 2 Hz with one iteration of 1.4 s: a minute holds 120 iterations, a shorter bucket too few. They end after
  // those of all other charts, so that the range begins with them.
  const slow = (chart) => {
    const from = (Math.floor(chart.from / 60) + 1) * 60, seconds = Array.from({ length: 600 }, (_, at) => at);
    const total = seconds.map((at) => (at === 333 ? 705 : 10)), points = [0, 60, 120, 240, 300, 360, 420, 480, 540].map((at) => [from + at, 11]);
    Object.assign(chart, { from, remote: false, n: seconds.map(() => 2), means: { total, inference: total }, transfers: { up: seconds.map(() => null), down: seconds.map(() => null) }, p95: { size: 60, points }, cpu: [], gpu: [] });
  };
  test("percentiles and means are the same at every width, each as long as its bucket", async () => {
    const drawings = [];
    for (const width of [400, 1440, 2560]) {
      const { all } = await first(slow, { width });
      drawings.push({ p95: all("p95"), inference: all("inference") });
    }
    assert.deepEqual(drawings[0], drawings[1]);
    assert.deepEqual(drawings[1], drawings[2]);
    const { p95 } = drawings[0], values = p95.map(({ value }) => value);
    assert.equal(Math.max(...values), 11, "no mean of percentiles of fewer iterations");
    assert.equal(values.filter((value) => value == null).length, 1, "the line stops where a bucket has no percentile");
    assert.deepEqual([p95[1].at - p95[0].at, values.length], [60e3, 19]);
  });

  test("the line of a host's CPU stops where nothing was heard of it", async () => {
    const { all } = await first((chart) => {
      const from = chart.from;
      Object.assign(chart, { remote: false, cpu: [[from, 90], [from + 5, 100], [from + 500, 100], [from + 505, 80]], gpu: [] });
    });
    assert.deepEqual(all("strip 0").map(({ value }) => value), [90, 100, null, 100, 80]);
  });
});

describe("what a run is worth", () => {
  test("its page says whether it can be published, by word and sign", async () => {
    const { page, errors, close } = await open(browser, base, pages.run);
    const trust = page.locator("#trust");
    assert.match(await trust.innerText(), /Can this run be published\?[\s\S]*(Yes|No)[:,]/);
    assert.ok((await trust.locator(".chip svg").count()) > 0);
    await trust.locator("summary").click();
    assert.match(await trust.innerText(), /iterations were answered|were answered/);
    const { verdict, answer } = await (await fetch(`${base}/api/v1${pages.run}/trust`)).json();
    assert.ok(["yes", "with-remarks", "no"].includes(verdict));
    assert.ok((await trust.innerText()).includes(answer.split(":")[0]));
    assert.deepEqual(errors, []);
    await close();
  });

  test("runs are chosen in their list and stand side by side, with a script and without", async () => {
    for (const script of [true, false]) {
      const { page, errors, close } = await open(browser, base, "/runs", { script });
      const numbers = await latest();
      for (const number of numbers) await page.locator(`input[name=runs][value="${number}"]`).check();
      await page.getByRole("button", { name: "Compare chosen" }).click();
      await page.waitForURL("**/compare?runs=*");
      assert.equal(await page.locator(".compare tbody tr").count(), numbers.length);
      assert.equal(await page.locator(".bars svg.stages[role=img]").count() >= numbers.length, true);
      assert.match(await page.locator("h1").innerText(), /smallest mean|smaller mean|less than|do not differ/);
      await page.locator(".compare tbody a").first().click();
      await page.waitForURL("**/runs/*");
      assert.deepEqual(errors, []);
      await close();
    }
  });
});

describe("clocks", () => {
  test("a link opens from its list, its picture moves and flips to a table with the same numbers", async () => {
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
    await moves(page, "#part-table");
    await page.getByRole("button", { name: "Table" }).click();
    assert.ok(await page.locator("#part-chart .tracks").isVisible());
    await page.getByRole("link", { name: "as measured" }).click();
    await page.waitForURL("**offset=measured");
    assert.ok((await page.locator(".tracks").first().getAttribute("aria-label")).includes("The offset was known to"));
    assert.deepEqual(errors, []);
    await close();
  });

  test("a clock that is made wrong on purpose is said on every page, and delays do not move with it", async () => {
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

  test("what a one-way delay is worth stays in sight on a phone, and a host with a long name on a screen", async () => {
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
