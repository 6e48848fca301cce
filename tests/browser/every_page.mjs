// Keyboard, print and accessibility of every page.
import assert from "node:assert/strict";
import { describe, test } from "node:test";
import { waitForCharts, waitForUpdate, open, horizontalOverflow, violations } from "./browser.mjs";
import { base, browser, pages } from "./dashboard.mjs";

describe("keys", () => {
  test("first Tab skips the navigation and focus is visible", async () => {
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

  test("shortcuts open pages, change the theme and show help", async () => {
    const { page, close } = await open(browser, base, "/");
    for (const [letter, path] of [["p", "/pipelines"], ["r", "/runs"], ["c", "/compare"], ["l", "/links"], ["h", "/hosts"], ["i", "/incidents"], ["o", "/"]]) {
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

  test("space pauses, / searches, arrows open neighbouring iterations", async () => {
    const { page, close } = await open(browser, base, "/");
    await page.keyboard.press("Space");
    assert.equal(await page.locator("#livetext").innerText(), "Paused");
    await page.keyboard.press("Space");
    await waitForUpdate(page, "#part-now");

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

describe("keys without an action", () => {
  test("space scrolls on a page without pause button", async () => {
    const { page, close } = await open(browser, base, pages.run, { height: 400 });
    assert.equal(await page.locator("#pause").count(), 0);
    await page.keyboard.press("Space");
    await page.waitForFunction(() => scrollY > 100);
    await close();
  });
});

describe("titles and print", () => {
  test("every page has a unique title", async () => {
    const titles = new Map();
    for (const [name, path] of Object.entries(pages)) {
      // This is the page `link` with another chart, so the title is the same.
      if (name === "linkMeasured") continue;
      const { page, close } = await open(browser, base, path);
      const title = await page.title();
      assert.ok(!titles.has(title), `${name} and ${titles.get(title)} have the same title: ${title}`);
      titles.set(title, name);
      await close();
    }
  });

  test("dark page prints in the light theme, unclipped", async () => {
    for (const path of ["/", pages.run, pages.compare]) {
      const { page, close } = await open(browser, base, path, { scheme: "dark" });
      await waitForCharts(page);
      const ink = () => page.evaluate(() => getComputedStyle(document.body).color);
      const dark = await ink();
      await page.emulateMedia({ media: "print", colorScheme: "dark" });
      await page.setViewportSize({ width: 718, height: 1000 });
      await page.evaluate(() => dispatchEvent(new Event("beforeprint")));
      assert.notEqual(await ink(), dark);
      assert.equal(await page.locator(".top").isVisible(), false);
      const overhangs = await page.evaluate(() => Array.from(document.querySelectorAll("canvas"), (one) => one.getBoundingClientRect().right - one.closest(".panel").getBoundingClientRect().right));
      assert.ok(overhangs.every((one) => one <= 0), `${path}: charts leave their panels by ${overhangs} px`);
      const clipped = await page.evaluate(() => Array.from(document.querySelectorAll(".scroll"), (one) => getComputedStyle(one).overflowX).filter((how) => how !== "visible"));
      assert.deepEqual(clipped, [], path);
      await page.evaluate(() => dispatchEvent(new Event("afterprint")));
      await page.emulateMedia({ media: "screen", colorScheme: "dark" });
      assert.equal(await ink(), dark, "the screen is as before");
      await close();
    }
  });
});

describe("accessibility", () => {
  for (const scheme of ["light", "dark"]) {
    for (const width of [400, 1440]) {
      test(`pages have no violations, overflow or errors: ${scheme}, ${width} px`, async () => {
        for (const [name, path] of Object.entries(pages)) {
          const { page, errors, close } = await open(browser, base, path, { width, scheme });
          await waitForCharts(page);
          assert.deepEqual(await violations(page), [], `${name} at ${width} px, ${scheme}`);
          assert.ok((await horizontalOverflow(page)) <= 0, `${name} scrolls sideways at ${width} px`);
          assert.deepEqual(errors, [], name);
          await close();
        }
      });
    }
  }
});
