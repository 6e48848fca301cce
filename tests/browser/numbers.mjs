// Checks that the dashboard's script writes numbers as the programs do, with the test cases of the
// crate `statistics`.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { runInNewContext } from "node:vm";

const read = (path) => readFileSync(new URL(`../../${path}`, import.meta.url), "utf8");
const numbers = runInNewContext(`${read("web/assets/js/numbers.js")}; NUMBERS`);
const cases = JSON.parse(read("daemon/statistics/tests/numbers.json"));

for (const [name, list] of Object.entries(cases)) {
  for (const [value, text] of list) {
    const written = numbers[name](...(Array.isArray(value) ? value : [value]));
    assert.equal(written, text, `${name} of ${JSON.stringify(value)}`);
  }
}
assert.deepEqual([0, 0.5, 20, 1500, 0.00002].map(numbers.tick), ["0", "0.5", "20", "1,500", "0.00002"]);
console.log(`numbers: ${Object.values(cases).flat().length} cases`);
