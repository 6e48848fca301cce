"""Duration of each page and API resource with a hundred million stored nodes, by a benchmark of the crate web."""

from __future__ import annotations

import re

from programs import ROOT, Failure, output
from report import Section, Table

BENCH = ["cargo", "bench", "--locked", "--quiet", "--package", "peernet-web", "--bench", "pages"]
# A page with median and maximum time over the small and over the large database, in ms, and the medians' ratio.
ROW = re.compile(r"^\| ([^|]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", re.MULTILINE)

# Positions in a row: median time over the large database, and ratio of the medians.
LARGE_MEDIAN, MEDIAN_RATIO = 3, 5

TIME_AIM_MS = 200.0
RATIO_AIM = 2.0
# Below this, the ratio depends more on the machine than on the page.
MEASURABLE_MS = 5.0


def prepare() -> None:
    output([*BENCH, "--no-run"], folder=ROOT, timeout_s=1800)


def measure(quick: bool) -> Section:
    nodes = 2_000_000 if quick else 100_000_000
    printed = output([*BENCH, "--", nodes], folder=ROOT, timeout_s=3600, show=True)
    rows = [(name, *map(float, figures)) for name, *figures in ROW.findall(printed)]
    if not rows:
        raise Failure(f"{' '.join(BENCH)} printed no row:\n{printed}")
    section = Section("Pages over many nodes")
    section.say(
        f"Each page and API resource 20 times, from the request to the compressed answer, with a database that contains a run of "
        f"{nodes:,} nodes, and with one of at most 1,000,000; milliseconds."
    )
    table = Table("page", "small, median", "max", "large, median", "max", "ratio")
    for name, *figures in rows:
        table.row(name, *(f"{figure:.2f}" for figure in figures))
    section.table(table)
    slowest = max(rows, key=lambda row: row[LARGE_MEDIAN])
    time_ms = slowest[LARGE_MEDIAN]
    section.aim(f"every page ≤ {TIME_AIM_MS:.0f} ms", f"{time_ms:.1f} ms ({slowest[0]})", time_ms <= TIME_AIM_MS)
    grown = max(rows, key=lambda row: row[MEDIAN_RATIO] if row[LARGE_MEDIAN] >= MEASURABLE_MS else 0.0)
    section.aim(
        f"every page of {MEASURABLE_MS:.0f} ms or more: ≤ {RATIO_AIM:.0f} × the time over 1,000,000 nodes",
        f"{grown[MEDIAN_RATIO]:.2f} × ({grown[0]})",
        grown[MEDIAN_RATIO] <= RATIO_AIM or grown[LARGE_MEDIAN] < MEASURABLE_MS,
    )
    return section
