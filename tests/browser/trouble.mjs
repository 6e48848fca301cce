// Pages during failures: lost connection, missing script, missing item, closed database.
// With DATABASE=FILE that file is moved away temporarily.
import assert from "node:assert/strict";
import { renameSync } from "node:fs";
import { describe, test } from "node:test";
import { waitForUpdate, open, violations } from "./browser.mjs";
import { base, browser, pages } from "./dashboard.mjs";

const database = process.env.DATABASE;

describe("failures", () => {
  test("lost connection is shown and recovers automatically", async () => {
    const { page, close } = await open(browser, base, "/");
    await waitForUpdate(page, "#part-now");
    const title = page.locator("h1"), figures = page.locator("#part-now");
    const pastTitle = /running at \d\d:\d\d:\d\d$/;
    assert.doesNotMatch(await title.innerText(), pastTitle);
    await page.waitForFunction(() => /^last report \d+\.\d\s?s ago$/.test(document.getElementById("livelag").textContent));
    await page.route("**/api/v1/live*", (route) => route.abort());
    // A page that returns from the back-forward cache opens its stream again, which now fails.
    await page.evaluate(() => dispatchEvent(new PageTransitionEvent("pageshow", { persisted: true })));
    await page.waitForFunction(() => !document.getElementById("banner").hidden);
    assert.match(await page.locator("#banner").innerText(), /Connection to the aggregator lost at \d\d:\d\d:\d\d/);
    assert.match(await title.innerText(), pastTitle);
    assert.equal(await page.locator("#livetext").innerText(), "Reconnecting");
    // The last figures stay on the page, and their age is shown.
    const lastFigures = await figures.innerText();
    assert.match(await figures.locator(".p50").first().innerText(), /\d/);
    await page.waitForFunction(() => /^last data ([2-9]|\d\d)\s?s ago$/.test(document.getElementById("livelag").textContent));
    assert.equal(await figures.innerText(), lastFigures);
    await page.unroute("**/api/v1/live*");
    await page.waitForFunction(() => document.getElementById("banner").hidden, null, { timeout: 15000 });
    await waitForUpdate(page, "#part-now");
    assert.doesNotMatch(await title.innerText(), pastTitle);
    assert.equal(await page.locator("#livetext").innerText(), "Live");
    await close();
  });

  test("every page shows a lost connection", async () => {
    let livePages = 0, dotCount = 0;
    for (const [name, path] of Object.entries(pages)) {
      const { page, close } = await open(browser, base, path);
      await page.waitForFunction(() => document.getElementById("livetext").textContent === "Live");
      const liveTitle = await page.locator("h1").innerText();
      await page.route("**/api/v1/live*", (route) => route.abort());
      await page.evaluate(() => dispatchEvent(new PageTransitionEvent("pageshow", { persisted: true })));
      await page.locator("#banner", { hasText: "Connection to the aggregator lost at" }).waitFor();
      // Only a title with live figures changes: it then says at what time it was true.
      const isUpdated = (await page.locator("[id^=part-] h1").count()) > 0;
      assert.equal((await page.locator("h1").innerText()) !== liveTitle, isUpdated, `${name}: a title with live figures shows its time`);
      // Without a connection, the dots of states are hollow.
      const dots = await page.locator("main .dot").evaluateAll((all) => all.map((dot) => getComputedStyle(dot).backgroundColor));
      assert.deepEqual(dots.filter((colour) => colour !== "rgba(0, 0, 0, 0)"), [], name);
      livePages += Number(isUpdated);
      dotCount += dots.length;
      await close();
    }
    assert.ok(livePages > 0 && dotCount > 0, `${livePages} pages have a live title, and the pages have ${dotCount} dots`);
  });

  test("pages without script show figures and tables", async () => {
    for (const [name, path] of Object.entries(pages)) {
      const { page, errors, close } = await open(browser, base, path, { script: false });
      assert.ok((await page.locator("main").innerText()).match(/\d/), `${name} shows figures`);
      assert.equal(await page.locator(".scripted:visible").count(), 0, `${name} offers nothing that needs a script`);
      assert.deepEqual(errors, [], name);
      await close();
    }
    const { page, close } = await open(browser, base, "/", { script: false });
    assert.ok(await page.locator("svg.stages").first().isVisible());
    assert.ok(await page.locator(".card table").first().isVisible(), "tables replace charts");
    await close();
  });

  test("missing run has an error page", async () => {
    const context = await browser.newContext({ baseURL: base });
    const page = await context.newPage();
    const answer = await page.goto("/runs/999999999");
    assert.equal(answer.status(), 404);
    assert.match(await page.locator("main").innerText(), /no run #999999999 is stored/);
    await context.close();
  });
});

describe("storage of events and runs", () => {
  test("event counts are updated and add up", async () => {
    const { page, errors, close } = await open(browser, base, pages.host);
    await waitForUpdate(page, "#part-accounting");
    assert.match(await page.locator("#part-accounting").innerText(), /Produced[\s\S]*Spooled[\s\S]*Sent[\s\S]*Acknowledged[\s\S]*Waiting[\s\S]*Dropped[\s\S]*Spool[\s\S]*Storing behind/);
    const { now } = await (await fetch(`${base}/api/v1${pages.host}`)).json();
    assert.equal(now.events.produced, now.events.acknowledged + now.events.waiting + now.events.dropped);
    assert.deepEqual(errors, []);
    await close();
  });

  test("pinning a run survives a reload", async () => {
    const { page, errors, close } = await open(browser, base, pages.run);
    const pin = page.locator("#pin"), chip = page.locator("#pinned");
    const pressed = () => pin.getAttribute("aria-pressed");
    assert.deepEqual([await pressed(), await chip.isVisible()], ["false", false]);
    await pin.focus();
    await page.keyboard.press("Enter");
    await chip.waitFor({ state: "visible" });
    assert.deepEqual([await pressed(), await page.evaluate(() => document.activeElement.id)], ["true", "pin"]);
    assert.equal((await pin.innerText()).trim(), "Pinned");
    await page.reload();
    assert.deepEqual([await pressed(), await chip.isVisible()], ["true", true]);
    await page.goto("/runs");
    assert.equal(await page.locator(`tr:has(a[href="${pages.run}"]) .chip`, { hasText: "pinned" }).count(), 1);
    await page.goto(pages.run);
    await pin.click();
    await chip.waitFor({ state: "hidden" });
    await page.reload();
    assert.deepEqual([await pressed(), await chip.isVisible()], ["false", false]);
    assert.deepEqual(errors, []);

    await page.route("**/pin", (route) => route.fulfill({ status: 503, contentType: "application/problem+json", body: JSON.stringify({ detail: "the disk is full" }) }));
    await pin.click();
    await page.locator("#pin-said", { hasText: "Not changed: the disk is full" }).waitFor();
    assert.deepEqual([await pressed(), await chip.isVisible()], ["false", false]);
    await close();
  });

  if (database) test("pages show while events are not stored", async () => {
    const { page, errors, close } = await open(browser, base, "/hosts");
    const notice = page.locator("#storing");
    assert.equal(await notice.isVisible(), false);
    renameSync(database, `${database}.away`);
    try {
      await notice.waitFor({ state: "visible" });
      assert.match(await notice.innerText(), /^Cannot store events: .*agents keep them/);
      assert.equal((await fetch(`${base}/readyz`)).status, 503);
      const other = await open(browser, base, "/links", { script: false });
      assert.ok(await other.page.locator("#storing").isVisible(), "without script, too");
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
