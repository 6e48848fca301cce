// Tests a running dashboard in a browser. Usage: node run.mjs http://127.0.0.1:8040
// With SCREENSHOTS=FOLDER, screenshots of every page in both themes and several widths are written there.
import { mkdirSync } from "node:fs";
import { test } from "node:test";
import { waitForCharts, open } from "./browser.mjs";
import { base, browser, pages } from "./dashboard.mjs";
import "./figures.mjs";
import "./episodes.mjs";
import "./legible.mjs";
import "./tabs.mjs";
import "./trouble.mjs";
import "./every_page.mjs";

const folder = process.env.SCREENSHOTS;

if (folder) {
  mkdirSync(folder, { recursive: true });
  test("screenshots", async () => {
    for (const [name, path] of Object.entries(pages)) {
      for (const [suffix, options] of Object.entries({ light: {}, dark: { scheme: "dark" }, phone: { width: 400, height: 800 }, projector: { width: 2560, height: 1440 } })) {
        const { page, close } = await open(browser, base, path, options);
        await waitForCharts(page);
        await page.screenshot({ path: `${folder}/${name}-${suffix}.png`, fullPage: true });
        await close();
      }
    }
  });
}
