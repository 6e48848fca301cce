// Headless Chromium that can reach only the address of the dashboard.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const require = createRequire(import.meta.url);
const axeSource = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

export async function launch(base) {
  const { hostname } = new URL(base);
  return chromium.launch({
    executablePath: process.env.CHROMIUM || "/usr/bin/chromium",
    args: [
      "--no-sandbox",
      "--disable-background-networking",
      "--disable-component-update",
      "--disable-domain-reliability",
      "--disable-sync",
      "--no-first-run",
      "--disable-features=OptimizationHints,MediaRouter,Translate,AutofillServerCommunication",
      `--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE ${hostname}`,
    ],
  });
}

// Opens a page and collects its errors and warnings.
export async function open(browser, base, path, options = {}) {
  const { width = 1440, height = 900, scheme = "light", script = true } = options;
  const context = await browser.newContext({ baseURL: base, viewport: { width, height }, colorScheme: scheme, javaScriptEnabled: script });
  const page = await context.newPage();
  const errors = [];
  page.on("console", (message) => { if (message.type() === "error" || message.type() === "warning") errors.push(message.text()); });
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("requestfailed", (request) => {
    // The browser aborts requests in progress, such as a stream or an icon, when its page is left.
    // Some tests block the live stream on purpose.
    const aborted = request.failure()?.errorText === "net::ERR_ABORTED";
    if (!aborted && !request.url().includes("/api/v1/live")) errors.push(`${request.url()}: ${request.failure()?.errorText}`);
  });
  const answer = await page.goto(path);
  if (!answer.ok()) throw new Error(`${path} answered with status ${answer.status()}`);
  return { page, errors, close: () => context.close() };
}

// Returns the violated rules of axe, each with its elements.
export async function violations(page) {
  await page.evaluate(axeSource);
  const found = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ["violations"] }));
  return found.violations.map((rule) => `${rule.id}: ${rule.help}\n  ${rule.nodes.slice(0, 4).map((node) => `${node.target.join(" ")}: ${node.failureSummary?.split("\n")[1]?.trim()}`).join("\n  ")}`);
}

// Returns how far the page can be scrolled sideways, in pixels.
export const horizontalOverflow = (page) => page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);

// Waits until the live figures of an element have changed. The element is scrolled into view, because only visible
// elements are updated.
export async function waitForUpdate(page, selector) {
  await page.locator(selector).first().scrollIntoViewIfNeeded();
  const before = await page.locator(selector).innerText();
  await page.waitForFunction(([where, text]) => document.querySelector(where)?.innerText !== text, [selector, before], { timeout: 30000 });
}

// Waits until all visible charts are drawn, which happens after the page is loaded.
export const waitForCharts = (page) => page.waitForFunction(() => Array.from(document.querySelectorAll(".chart")).every((chart) => chart.querySelector("canvas") || !chart.clientWidth), null, { timeout: 30000 });

// Opens a page with charts whose data `change` has changed. The live stream is blocked, so that nothing is added.
export async function openWithData(browser, base, path, change, options) {
  // Another page is opened first, because the routes must be set before `path` is loaded.
  const opened = await open(browser, base, "/compare", options), { page } = opened;
  await page.route("**/api/v1/live*", (route) => route.abort());
  await page.route(`${base}${path}`, async (route) => {
    const answer = await route.fetch();
    const body = (await answer.text()).replace(/(<script[^>]*id="data"[^>]*>)(.*?)(<\/script>)/s, (_, begin, data, end) => {
      const changed = JSON.parse(data);
      change(changed);
      return begin + JSON.stringify(changed).replaceAll("<", "\\u003c") + end;
    });
    await route.fulfill({ response: answer, body });
  });
  await page.goto(path);
  await waitForCharts(page);
  return opened;
}
