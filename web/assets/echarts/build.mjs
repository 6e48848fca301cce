// Writes ../echarts.min.js, which is committed: building the daemon needs no Node.
//   npm ci && npm run build
import { build } from "esbuild";
import { readFileSync } from "node:fs";
import { gzipSync } from "node:zlib";
import { fileURLToPath } from "node:url";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const { version } = JSON.parse(readFileSync(here("node_modules/echarts/package.json"), "utf8"));
const outfile = here("../echarts.min.js");

await build({
  entryPoints: [here("entry.js")],
  outfile,
  bundle: true,
  minify: true,
  format: "iife",
  globalName: "echarts",
  target: ["es2020"],
  legalComments: "none",
  banner: { js: `/*! Apache ECharts ${version}, Apache-2.0; zrender, BSD-3-Clause; tslib, 0BSD: see echarts.LICENSE */` },
});

const bytes = readFileSync(outfile);
console.log(`echarts ${version}: ${bytes.length} bytes, ${gzipSync(bytes, { level: 9 }).length} gzipped`);
