// The tested dashboard: a browser, and the address of each page.
import assert from "node:assert/strict";
import { after, before } from "node:test";
import { launch } from "./browser.mjs";

export const base = process.argv[2] || process.env.BASE_URL || "http://127.0.0.1:8040";
const TIMEOUT_MS = 60000;

// Set before the tests run.
export let browser, pages;

// Waits for a run with enough iterations in the store and returns it, if possible a run of a remote pipeline.
async function waitForRun() {
  const until = Date.now() + TIMEOUT_MS;
  for (;;) {
    const { runs } = await (await fetch(`${base}/api/v1/runs`)).json();
    const measured = runs.filter((one) => !one.experiment && one.total?.count >= 30);
    const run = measured.find((one) => one.placement.kind === "remote") || measured[0];
    if (run) return run;
    assert.ok(Date.now() < until, `no run of ${base} has 30 iterations; is the demo running?`);
    await new Promise((resolve) => setTimeout(resolve, 500));
  }
}

// Returns the numbers of the newest run with figures of each of two pipelines of the demo.
export async function newestRunNumbers() {
  const { runs } = await (await fetch(`${base}/api/v1/runs`)).json();
  const measured = runs.filter((run, at) => run.total && !run.experiment && runs.findIndex((one) => one.pipeline === run.pipeline) === at);
  assert.ok(measured.length > 1, "fewer than two pipelines have a run with figures");
  return measured.slice(0, 2).map((run) => run.number);
}

// Returns the id of the experiment that run.sh executes.
async function experimentId() {
  const { experiments } = await (await fetch(`${base}/api/v1/experiments`)).json();
  const experiment = experiments.find((one) => one.name === "tasks");
  assert.ok(experiment, `no run of an experiment "tasks" is stored by ${base}`);
  return experiment.id;
}

before(async () => {
  browser = await launch(base);
  const run = await waitForRun();
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
    compare: `/compare?runs=${(await newestRunNumbers()).join(",")}`,
    experiment: `/compare?experiment=${await experimentId()}`,
    compareEmpty: "/compare",
  };
});
after(() => browser?.close());
