"""What storing costs the agent: the same pipelines with and without an aggregator to send to."""

from __future__ import annotations

import time

import store
from deployment import Deployment, free_ports, deployment
from programs import Failure
from report import Section, Table, micros

from . import idle

# Iterations per second. An iteration of a local pipeline has 10 nodes, so 100 Hz are the 1,000 nodes/s of the aims.
RATES_HZ = (100, 2_000)
PROCESSOR_AIM = 0.02
MEMORY_AIM = 60 * 2**20


def prepare() -> None:
    pass


def measure(quick: bool) -> Section:
    seconds, repeats = (6.0, 1) if quick else (20.0, 3)
    section = Section("What an agent's events cost")
    section.say(
        f"A pipeline with the model `echo` at a fixed rate, {seconds:.0f} s, median of {repeats}: an agent without an "
        "aggregator, which measures and keeps live figures, and one with, which also encodes, spools and sends. The "
        "difference, divided by the nodes, is the cost of a node from the timer's stop to the acknowledgement."
    )
    table = Table(
        "rate", "nodes/s", "without, % of a core", "with, % of a core", "per node, µs", "resident, MiB", "spool's share, MiB"
    )
    for hz in RATES_HZ:
        rows = sorted((_pair(hz, seconds) for _ in range(repeats)), key=lambda row: row[2] - row[1])
        nodes, without, using, resident, added = rows[len(rows) // 2]
        table.row(
            f"{hz:,} Hz",
            f"{nodes:,.0f}",
            f"{100 * without:.2f}",
            f"{100 * using:.2f}",
            micros((using - without) / nodes),
            f"{resident / 2**20:.1f}",
            f"{added / 2**20:.1f}",
        )
        if hz == RATES_HZ[0]:
            section.aim("agent at 1,000 nodes/s ≤ 2 % of a core", f"{100 * using:.2f} %", using <= PROCESSOR_AIM)
            section.aim("agent at 1,000 nodes/s ≤ 60 MiB", f"{resident / 2**20:.1f} MiB", resident <= MEMORY_AIM)
    section.table(table)
    return section


def _pair(hz: int, seconds: float) -> tuple[float, float, float, float, float]:
    """Measures an agent without and an agent with an aggregator.

    Returns the nodes per second, both processor shares, the memory with an aggregator, and the memory that it adds.
    """
    events, web = free_ports(2)
    with deployment() as daemons:
        daemons.aggregator(events=events, web=web)
        agents = {
            "without": daemons.daemon("without", _agent(daemons, "without", hz, "")),
            "with": daemons.daemon("with", _agent(daemons, "with", hz, f'aggregator = "tcp://127.0.0.1:{events}"')),
        }
        before, began = store.nodes(daemons.database), time.monotonic()
        costs = idle.measure_costs(agents, seconds)
        nodes = (store.nodes(daemons.database) - before) / (time.monotonic() - began)
    if nodes < hz:
        raise Failure(f"{nodes:.0f} nodes/s were stored at {hz} Hz, fewer than one per iteration")
    without, using = costs["without"], costs["with"]
    return nodes, without.processor, using.processor, using.resident, using.resident - without.resident


def _agent(daemons: Deployment, name: str, hz: int, aggregator_line: str) -> str:
    return f"""
        [agent]
        name = "{name}"
        state_dir = "{daemons.folder}/{name}"
        {aggregator_line}
        [[model]]
        name = "echo"
        kind = "echo"
        [[pipeline]]
        name = "line"
        sensor = {{ kind = "synthetic", size_bytes = 64 }}
        load = {{ mode = "rate", hz = {hz} }}
        placement = {{ kind = "local", model = "echo" }}
    """
