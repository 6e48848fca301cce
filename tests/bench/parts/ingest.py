"""Nodes per second that reach the database: the aggregator's own benchmark."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from statistics import median

from programs import ROOT, Failure, Program, output
from report import Section, Table, rate

BENCH = ["cargo", "bench", "--locked", "--quiet", "--package", "peernet-aggregator", "--bench", "ingest"]
# What the benchmark prints per round: aggregator and bare loop in nodes/s, their ratio, bytes a node, the aggregator's
# greatest memory in MiB, nodes lost.
ROUND = re.compile(r"^\s*\d+\s+(\d+)\s+(\d+)\s+([\d.]+)\s+([\d.]+)\s+(\d+)\s+(-?\d+)$", re.MULTILINE)

# Nodes/s that are promised on two cores, by the number of agents; `None`: no rate is promised.
RATE_AIMS = {1: None, 10: 500_000, 1_000: 350_000}
RATIO_AIM = 0.6
MEMORY_AIM_MIB = 512


def prepare() -> None:
    output([*BENCH, "--no-run"], folder=ROOT, timeout_s=1800)


def measure(quick: bool) -> Section:
    nodes, rounds = (1_000_000, 1) if quick else (4_000_000, 3)
    section = Section("Ingest")
    section.say(
        f"About {nodes:,} nodes from simulated agents over ZeroMQ into the database, every transaction synced to disk; "
        "beside it a loop that inserts the same rows in the order of their arrival into the same schema, without "
        f"roll-ups. Aggregator, agents and loop are processes of their own. {rounds} rounds, medians; memory: the most "
        "that the aggregator ever held."
    )
    table = Table("agents", "nodes/s", "bare loop, nodes/s", "ratio", "bytes a node", "peak, MiB", "lost")
    for agents, aim in RATE_AIMS.items():
        printed = output([*BENCH, "--", nodes, rounds, agents], folder=ROOT, timeout_s=1800)
        columns = list(zip(*(map(float, line) for line in ROUND.findall(printed)), strict=True))
        if not columns:
            raise Failure(f"{' '.join(BENCH)} printed no round:\n{printed}")
        ours, bare, share, node_bytes = map(median, columns[:4])
        peak, lost = max(columns[4]), int(sum(columns[5]))
        figures = (f"{share:.2f} ×", f"{node_bytes:.1f}", f"{peak:.0f}", f"{lost:,}")
        table.row(f"{agents:,}", rate(ours), rate(bare), *figures)
        if aim is not None:
            section.aim(f"ingest from {agents:,} agents ≥ {aim:,} nodes/s", rate(ours), ours >= aim)
        section.aim(f"ingest from {agents:,} ≥ {RATIO_AIM} × a bare loop", f"{share:.2f} ×", share >= RATIO_AIM)
        section.aim(f"lost of {agents:,} agents: 0", f"{lost:,}", lost == 0)
        if agents == max(RATE_AIMS):
            section.aim(f"memory with {agents:,} agents ≤ {MEMORY_AIM_MIB} MiB", f"{peak:.0f} MiB", peak <= MEMORY_AIM_MIB)
    section.table(table)
    return section


def generator(log: Path, port: int, agents: int, nodes: int, speed: float) -> Program:
    """Starts a process of simulated agents, which send about `nodes` nodes in all.

    `speed` is a multiple of 500,000 nodes/s; of 350,000 nodes/s with 1,000 agents or more.
    """
    return Program([_program(), "generator", f"tcp://127.0.0.1:{port}", agents, nodes, speed], log)


def _program() -> Path:
    """Returns the path of the benchmark's binary, which cargo prints."""
    built = subprocess.run(
        [*BENCH, "--no-run", "--message-format", "json"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    for line in built.stdout.splitlines():
        message = json.loads(line)
        if message.get("executable") and message["target"]["name"] == "ingest":
            return Path(message["executable"])
    raise Failure(f"{' '.join(BENCH)} built no program:\n{built.stderr}")
