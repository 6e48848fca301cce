// Measures the processor time of the overview in a browser. Usage: node cost.mjs URL SECONDS
// Prints as JSON the share of the time in which the page's main thread worked, by the browser's
// counters: once in processor time (`processor`), once in elapsed time (`passed`).
// PROFILE=FILE writes a profile of the scripts, which the developer tools can open.
import { writeFileSync } from "node:fs";
import { waitForCharts, launch, waitForUpdate, open } from "./browser.mjs";

const [base, seconds] = [process.argv[2], Number(process.argv[3])];
const NAMES = { task: "TaskDuration", script: "ScriptDuration", layout: "LayoutDuration", style: "RecalcStyleDuration" };

// Measures the counters for `seconds` and returns each as a share of the elapsed time. `timeDomain` says whether a
// counter adds up processor time (threadTicks) or elapsed time (timeTicks).
async function costs(browser, timeDomain) {
  const { page, close } = await open(browser, base, "/");
  await waitForCharts(page);
  await waitForUpdate(page, "#part-now");
  const session = await page.context().newCDPSession(page);
  await session.send("Performance.enable", { timeDomain });
  const profiled = process.env.PROFILE && timeDomain === "threadTicks";
  if (profiled) {
    await session.send("Profiler.enable");
    await session.send("Profiler.start");
  }
  const read = async () => {
    const { metrics } = await session.send("Performance.getMetrics");
    return Object.fromEntries(metrics.map(({ name, value }) => [name, value]));
  };
  const before = await read();
  await page.waitForTimeout(seconds * 1000);
  const after = await read(), passed = after.Timestamp - before.Timestamp;
  if (profiled) writeFileSync(process.env.PROFILE, JSON.stringify((await session.send("Profiler.stop")).profile));
  await close();
  return Object.fromEntries(Object.entries(NAMES).map(([key, name]) => [key, (after[name] - before[name]) / passed]));
}

const browser = await launch(base);
try {
  console.log(JSON.stringify({ processor: await costs(browser, "threadTicks"), passed: await costs(browser, "timeTicks") }));
} finally {
  await browser.close();
}
