"""Nodes per second that reach the database: the aggregator's own benchmark."""

from __future__ import annotations

import re
from statistics import median

from programs import ROOT, Failure, output
from report import Section, Table, rate

BENCH = ["cargo", "bench", "--locked", "--quiet", "--package", "peernet-aggregator", "--bench", "ingest"]
# What the benchmark prints per round: aggregator and bare loop in nodes/s, their ratio, bytes a node, nodes dropped.
ROUND = re.compile(r"^\s*\d+\s+(\d+)\s+(\d+)\s+([\d.]+)\s+([\d.]+)\s+(-?\d+)$", re.MULTILINE)

# The published program stores nothing but a CSV file; this is what its successor promises on two cores.
RATE_AIM = 500_000


def prepare() -> None:
    output([*BENCH, "--no-run"], folder=ROOT, timeout_s=1800)


def measure(quick: bool) -> Section:
    nodes, agents, rounds = (500_000, 10, 1) if quick else (2_000_000, 10, 5)
    printed = output([*BENCH, "--", nodes, agents, rounds], folder=ROOT, timeout_s=900)
    columns = list(zip(*(map(float, line) for line in ROUND.findall(printed)), strict=True))
    if not columns:
        raise Failure(f"{' '.join(BENCH)} printed no round:\n{printed}")
    ours, bare, ratios, size = map(median, columns[:4])
    dropped = int(sum(columns[4]))

    section = Section("Ingest")
    section.say(
        f"{nodes:,} nodes from {agents} agents over ZeroMQ into the database, every transaction synced to disk; beside "
        f"it a loop that inserts the same rows into the same schema. {rounds} rounds, medians."
    )
    table = Table("nodes per second", "aggregator", "bare loop", "ratio", "bytes a node", "dropped")
    table.row("stored", rate(ours), rate(bare), f"{ratios:.2f} ×", f"{size:.1f}", f"{dropped:,}")
    section.table(table)
    section.aim(f"ingest ≥ {RATE_AIM:,} nodes/s", rate(ours), ours >= RATE_AIM)
    section.aim("events dropped by ingest: 0", f"{dropped:,}", dropped == 0)
    return section
