"""One timed node: the logger's own benchmark, and the same in Python."""

from __future__ import annotations

import json
import re
from statistics import median

from programs import ROOT, Failure, output, peer
from report import Section, Table, times

BENCH = ["cargo", "bench", "--locked", "--quiet", "--package", "peernet-logger", "--bench", "node"]
# What the benchmark prints: a name, some space, a number, the rest.
LINE = re.compile(r"^(?P<name>\S.*?)\s{2,}(?P<number>[\d.]+) (?P<rest>.+)$", re.MULTILINE)
READS, NODE = "two bare clock reads", "one timed node"

# Largest aimed-for ratio of a timed node's cost to that of two clock reads.
READS_AIM = 2.5
# Smallest aimed-for ratio of Python's cost to PEERNet's.
PYTHON_AIM = 15.0


def prepare() -> None:
    output([*BENCH, "--no-run"], folder=ROOT, timeout_s=1800)


def measure(quick: bool) -> Section:
    section = Section("One timed node")
    printed = output(BENCH, folder=ROOT, timeout_s=300)
    nodes, repeats = (2_000, 5) if quick else (20_000, 15)
    python_ns = median(json.loads(output(peer("timer", nodes, repeats)))) * 1e9
    lines = [match.group("name", "number", "rest") for match in LINE.finditer(printed)]
    nanos = {name: float(number) for name, number, rest in lines if rest == "ns"}
    if not {READS, NODE} <= nanos.keys():
        raise Failure(f"{' '.join(BENCH)} printed no figure for {READS!r} or {NODE!r}:\n{printed}")
    cost, gain = nanos[NODE] / nanos[READS], python_ns / nanos[NODE]

    section.say(
        "The logger's own benchmark, medians over interleaved repeats; below it, a logger in Python like that of the "
        "paper's program."
    )
    table = Table("what", "cost", "")
    for name, number, rest in lines:
        table.row(name, number, rest)
    table.row("Python: one timed node", f"{python_ns:.1f}", "ns")
    table.row(f"PEERNet to Python: {NODE}", f"{gain:.2f}", f"x faster (aim: {PYTHON_AIM:g} or more)")
    section.table(table)

    section.aim(f"a timed node ≤ {READS_AIM:g} × two clock reads", times(cost), cost <= READS_AIM)
    section.aim(f"a timed node ≥ {PYTHON_AIM:g} × cheaper than a Python logger's", times(gain), gain >= PYTHON_AIM)
    return section
