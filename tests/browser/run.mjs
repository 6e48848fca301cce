// Opens a running dashboard and looks at it as a person would: node run.mjs http://127.0.0.1:8040
// With DATABASE=FILE that file is moved away for a moment, to see what the pages say then.
// With SCREENSHOTS=FOLDER every page is written there as a picture, in both themes and at four widths.
import assert from "node:assert/strict";
import { mkdirSync, renameSync } from "node:fs";
import { after, before, describe, test } from "node:test";
import { drawn, launch, moves, open, sideways, violations } from "./browser.mjs";

const base = process.argv[2] || process.env.BASE_URL || "http://127.0.0.1:8040";
const folder = process.env.SCREENSHOTS;
const database = process.env.DATABASE;
const PATIENCE = 60000;

let browser, pages;

// A finished part of a run is needed: asked for until the store has it.
async function stored() {
  const until = Date.now() + PATIENCE;
  for (;;) {
    const { runs } = await (await fetch(`${base}/api/v1/runs`)).json();
    const run = runs.find((one) => one.placement.kind === "remote" && one.total?.count >= 30) || runs.find((one) => one.total?.count >= 30);
    if (run) return run;
    assert.ok(Date.now() < until, `no run of ${base} has 30 iterations; is the demo running?`);
    await new Promise((resolve) => setTimeout(resolve, 500));
  }
}

// The newest runs with figures, one of each pipeline: at least two are needed.
async function latest() {
  const { runs } = await (await fetch(`${base}/api/v1/runs`)).json();
  const measured = runs.filter((run, at) => run.total && runs.findIndex((one) => one.pipeline === run.pipeline) === at);
  assert.ok(measured.length > 1, "two pipelines have measured something");
  return measured.slice(0, 2).map((run) => run.number);
}

before(async () => {
  browser = await launch(base);
  const run = await stored();
  const { iterations } = await (await fetch(`${base}/api/v1/runs/${run.number}/iterations?order=slowest&limit=1`)).json();
  pages = {
    overview: "/",
    pipelines: "/pipelines",
    pipeline: `/pipelines/${run.host}/${run.pipeline}`,
    runs: "/runs",
    run: `/runs/${run.number}`,
    iteration: `/runs/${run.number}/iterations/${iterations[0].number}`,
    links: "/links",
    link: `/links/${run.host}~${run.placement.peer}`,
    linkMeasured: `/links/${run.host}~${run.placement.peer}?range=1h&offset=measured`,
    hosts: "/hosts",
    host: `/hosts/${run.host}`,
    incidents: "/incidents",
    compare: `/compare?runs=${(await latest()).join(",")}`,
    compareEmpty: "/compare",
  };
  if (folder) mkdirSync(folder, { recursive: true });
});
after(() => browser?.close());

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
      assert.match(await page.locator("h1").innerText(), /fastest|less than|do not differ/);
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
      assert.match(await page.locator("#rehearsal").innerText(), /^Rehearsal: edge's clock is made wrong on purpose/, name);
      await close();
    }
    const link = await (await fetch(`${base}/api/v1${pages.link}`)).json();
    assert.ok(Math.abs(link.now.offset.estimate_s + 1) < 0.1, `the cloud is a second behind: ${link.now.offset.estimate_s}`);
    assert.ok(link.now.up.median.value_s < 0.5, "an upload on one machine takes no second");
    const { page, close } = await open(browser, base, pages.runs);
    assert.ok((await page.locator(".runs tbody tr .chip", { hasText: "rehearsal" }).count()) > 0, "its runs are marked in their list");
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

describe("keys", () => {
  test("the first tab leads past the navigation, the focus can be seen", async () => {
    const { page, close } = await open(browser, base, "/");
    await page.keyboard.press("Tab");
    assert.equal(await page.evaluate(() => document.activeElement.textContent), "Skip to content");
    await page.keyboard.press("Enter");
    assert.equal(await page.evaluate(() => document.activeElement.id), "main");
    await page.keyboard.press("Tab");
    const ring = await page.evaluate(() => getComputedStyle(document.activeElement).outlineWidth);
    assert.equal(ring, "2px");
    await close();
  });

  test("g and a letter open pages, t changes the theme, ? lists the keys", async () => {
    const { page, close } = await open(browser, base, "/");
    for (const [letter, path] of [["p", "/pipelines"], ["r", "/runs"], ["l", "/links"], ["h", "/hosts"], ["i", "/incidents"], ["o", "/"]]) {
      await page.keyboard.press("g");
      await page.keyboard.press(letter);
      await page.waitForURL(`${base}${path}`);
    }
    await page.keyboard.press("t");
    assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), "dark");
    await page.reload();
    assert.equal(await page.evaluate(() => document.documentElement.dataset.theme), "dark");
    await page.keyboard.press("?");
    assert.ok(await page.getByRole("dialog", { name: "Keyboard" }).isVisible());
    await page.keyboard.press("Escape");
    assert.ok(!(await page.getByRole("dialog", { name: "Keyboard" }).isVisible()));
    await close();
  });

  test("space pauses and resumes, / searches, arrows go from iteration to iteration", async () => {
    const { page, close } = await open(browser, base, "/");
    await page.keyboard.press("Space");
    assert.equal(await page.locator("#livetext").innerText(), "Paused");
    await page.keyboard.press("Space");
    await moves(page, "#part-now");

    await page.goto("/runs");
    await page.keyboard.press("/");
    await page.keyboard.type("no run is called like this");
    assert.equal(await page.locator(".runs tbody tr:visible").count(), 0);

    await page.goto(pages.iteration);
    const next = page.locator("a[rel=next]"), other = (await next.count()) ? next : page.locator("a[rel=prev]");
    const target = await other.getAttribute("href");
    await page.keyboard.press((await next.count()) ? "ArrowRight" : "ArrowLeft");
    await page.waitForURL(`**${target}`);
    await close();
  });
});

describe("when things go wrong", () => {
  test("a lost connection is said, figures stay, and it comes back by itself", async () => {
    const { page, close } = await open(browser, base, "/");
    await moves(page, "#part-now");
    const figure = await page.locator("#part-now .p50").first().innerText();
    await page.route("**/api/v1/live*", (route) => route.abort());
    await page.evaluate(() => dispatchEvent(new PageTransitionEvent("pageshow", { persisted: true })));
    await page.waitForFunction(() => !document.getElementById("banner").hidden);
    assert.match(await page.locator("#banner").innerText(), /Connection to the aggregator lost at \d\d:\d\d:\d\d/);
    assert.match(await page.locator("h1").innerText(), /running at \d\d:\d\d:\d\d$/);
    assert.equal(await page.locator("#livetext").innerText(), "Reconnecting");
    assert.ok(figure.length > 0 && (await page.locator("#part-now .p50").first().innerText()).length > 0);
    await page.unroute("**/api/v1/live*");
    await page.waitForFunction(() => document.getElementById("banner").hidden, null, { timeout: 15000 });
    await moves(page, "#part-now");
    assert.doesNotMatch(await page.locator("h1").innerText(), /were running at/);
    await close();
  });

  test("a lost connection is said on every page, and no dot stays green", async () => {
    for (const [name, path] of Object.entries(pages)) {
      const { page, close } = await open(browser, base, path);
      await page.waitForFunction(() => document.getElementById("livetext").textContent === "Live");
      const alive = await page.locator("h1").innerText();
      await page.route("**/api/v1/live*", (route) => route.abort());
      await page.evaluate(() => dispatchEvent(new PageTransitionEvent("pageshow", { persisted: true })));
      await page.locator("#banner", { hasText: "Connection to the aggregator lost at" }).waitFor();
      const live = (await page.locator("[id^=part-] h1").count()) > 0;
      assert.equal((await page.locator("h1").innerText()) !== alive, live, `${name}: a live title says of when it is`);
      const dots = await page.locator("main .dot").evaluateAll((all) => all.map((dot) => getComputedStyle(dot).backgroundColor));
      assert.deepEqual(dots.filter((colour) => colour !== "rgba(0, 0, 0, 0)"), [], name);
      await close();
    }
  });

  test("without a script the figures and tables are there", async () => {
    for (const [name, path] of Object.entries(pages)) {
      const { page, errors, close } = await open(browser, base, path, { script: false });
      assert.ok((await page.locator("main").innerText()).match(/\d/), `${name} shows figures`);
      assert.equal(await page.locator(".scripted:visible").count(), 0, `${name} offers nothing that needs a script`);
      assert.deepEqual(errors, [], name);
      await close();
    }
    const { page, close } = await open(browser, base, "/", { script: false });
    assert.ok(await page.locator("svg.stages").first().isVisible());
    assert.ok(await page.locator(".card table").first().isVisible(), "tables stand where charts would");
    await close();
  });

  test("what is not there is said on a page of its own", async () => {
    const context = await browser.newContext({ baseURL: base });
    const page = await context.newPage();
    const answer = await page.goto("/runs/999999999");
    assert.equal(answer.status(), 404);
    assert.match(await page.locator("main").innerText(), /no run #999999999 is stored/);
    await context.close();
  });
});

describe("events on their way to the database", () => {
  test("what became of them moves while one looks, and adds up", async () => {
    const { page, errors, close } = await open(browser, base, pages.host);
    await moves(page, "#part-accounting");
    assert.match(await page.locator("#part-accounting").innerText(), /Produced[\s\S]*Spooled[\s\S]*Sent[\s\S]*Acknowledged[\s\S]*Waiting[\s\S]*Dropped[\s\S]*Spool[\s\S]*Storing behind/);
    const { now } = await (await fetch(`${base}/api/v1${pages.host}`)).json();
    assert.equal(now.events.produced, now.events.acknowledged + now.events.waiting + now.events.dropped);
    assert.deepEqual(errors, []);
    await close();
  });

  test("a run is kept and let go, and a reload does not change that", async () => {
    const { page, errors, close } = await open(browser, base, pages.run);
    const keep = page.locator("#keep"), chip = page.locator("#kept");
    const pressed = () => keep.getAttribute("aria-pressed");
    assert.deepEqual([await pressed(), await chip.isVisible()], ["false", false]);
    await keep.focus();
    await page.keyboard.press("Enter");
    await chip.waitFor({ state: "visible" });
    assert.deepEqual([await pressed(), await page.evaluate(() => document.activeElement.id)], ["true", "keep"]);
    assert.equal((await keep.innerText()).trim(), "Kept");
    await page.reload();
    assert.deepEqual([await pressed(), await chip.isVisible()], ["true", true]);
    await page.goto("/runs");
    assert.equal(await page.locator(`tr:has(a[href="${pages.run}"]) .chip`, { hasText: "kept" }).count(), 1);
    await page.goto(pages.run);
    await keep.click();
    await chip.waitFor({ state: "hidden" });
    await page.reload();
    assert.deepEqual([await pressed(), await chip.isVisible()], ["false", false]);
    assert.deepEqual(errors, []);

    await page.route("**/pin", (route) => route.fulfill({ status: 503, contentType: "application/problem+json", body: JSON.stringify({ detail: "the disk is full" }) }));
    await keep.click();
    await page.locator("#keep-said", { hasText: "Not changed: the disk is full" }).waitFor();
    assert.deepEqual([await pressed(), await chip.isVisible()], ["false", false]);
    await close();
  });

  if (database) test("that they are not stored is said on every page for as long as it is so", async () => {
    const { page, errors, close } = await open(browser, base, "/hosts");
    const notice = page.locator("#storing");
    assert.equal(await notice.isVisible(), false);
    renameSync(database, `${database}.away`);
    try {
      await notice.waitFor({ state: "visible" });
      assert.match(await notice.innerText(), /^Cannot store events: .*agents keep them/);
      assert.equal((await fetch(`${base}/readyz`)).status, 503);
      const other = await open(browser, base, "/links", { script: false });
      assert.ok(await other.page.locator("#storing").isVisible(), "without a script as well");
      assert.deepEqual(await violations(page), []);
      await other.close();
    } finally {
      renameSync(`${database}.away`, database);
    }
    await notice.waitFor({ state: "hidden" });
    assert.equal((await fetch(`${base}/readyz`)).status, 200);
    assert.deepEqual(errors, []);
    await close();
  });
});

describe("for everyone", () => {
  for (const scheme of ["light", "dark"]) {
    for (const width of [400, 1440]) {
      test(`no page breaks a rule of accessibility, scrolls sideways or complains: ${scheme}, ${width} px`, async () => {
        for (const [name, path] of Object.entries(pages)) {
          const { page, errors, close } = await open(browser, base, path, { width, scheme });
          await drawn(page);
          assert.deepEqual(await violations(page), [], `${name} at ${width} px, ${scheme}`);
          assert.ok((await sideways(page)) <= 0, `${name} scrolls sideways at ${width} px`);
          assert.deepEqual(errors, [], name);
          await close();
        }
      });
    }
  }
});

if (folder) {
  test("pictures", async () => {
    for (const [name, path] of Object.entries(pages)) {
      for (const [suffix, options] of Object.entries({ light: {}, dark: { scheme: "dark" }, phone: { width: 400, height: 800 }, projector: { width: 2560, height: 1440 } })) {
        const { page, close } = await open(browser, base, path, options);
        await drawn(page);
        await page.screenshot({ path: `${folder}/${name}-${suffix}.png`, fullPage: true });
        await close();
      }
    }
  });
}
