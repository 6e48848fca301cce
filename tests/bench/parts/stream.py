"""One agent's durable stream on a fast link: the cost of the control of bytes in flight."""

from __future__ import annotations

import json
import subprocess
from statistics import median

import store
from namespaces import Host, need_root, two_hosts
from deployment import deployment
from programs import EVENT_STREAM, ROOT, Failure, output
from report import Section, Table, rate, ratio, times

# Delays that are added to the cable's own round trip.
ROUND_TRIPS_MS = (0, 1, 20)
# Nodes of an iteration of the generator.
NODES = 21
PORT = 5550
# Smallest aimed-for ratio of the rate with control to the rate without. The rates include the slow start of a
# connection.
AIM = 0.9
CONTROL = ("on", "off")


def prepare() -> None:
    need_root()
    build = ["cargo", "build", "--release", "--locked", "--quiet", "--package", "peernet-tests"]
    subprocess.run([*build, "--bin", "event-stream"], cwd=ROOT, check=True)


def measure(quick: bool) -> Section:
    iterations, repeats = (20_000, 1) if quick else (100_000, 9)
    section = Section("One stream on a fast link")
    section.say(
        f"A backlog of {iterations:,} iterations of {NODES} nodes from one agent, as fast as the aggregator takes it, "
        "over a veth pair: with the control of bytes in flight, which keeps live figures fresh on slow links, and "
        f"without it. {repeats} repeats in turn; medians, ratios taken repeat by repeat. The longer round trips are "
        "made in the sending program."
    )
    table = Table("round trip", "nodes/s", "without control", "ratio", "frames", "without control")
    with two_hosts() as (edge, cloud):
        for round_trip in ROUND_TRIPS_MS:
            rates: dict[str, list[float]] = {name: [] for name in CONTROL}
            frames: dict[str, list[float]] = {name: [] for name in CONTROL}
            for repeat in range(repeats):
                for name in CONTROL if repeat % 2 == 0 else reversed(CONTROL):
                    figures = _deliver(edge, cloud, iterations, round_trip, name)
                    rates[name].append(iterations * NODES / figures["seconds"])
                    frames[name].append(figures["frames"])
            share = ratio(rates["on"], rates["off"])
            round_trip_text = "the cable's" if round_trip == 0 else f"{round_trip} ms more"
            cells = [rate(median(by_control[name])) for by_control in (rates, frames) for name in CONTROL]
            table.row(round_trip_text, *cells[:2], times(share), *cells[2:])
            promise = f"one stream, {round_trip_text}: ≥ {AIM:g} × without control"
            section.aim(promise, times(share), share >= AIM)
    section.table(table)
    return section


def _deliver(edge: Host, cloud: Host, iterations: int, round_trip_ms: int, control: str) -> dict[str, float]:
    address = f"tcp://{cloud.address}:{PORT}"
    with deployment() as daemons:
        daemons.aggregator(cloud, events=PORT)
        printed = output(edge.inside([EVENT_STREAM, address, iterations, round_trip_ms, control]), timeout_s=120)
        if (stored := store.nodes(daemons.database)) != iterations * NODES:
            raise Failure(f"{stored:,} nodes were stored of {iterations * NODES:,}")
    return json.loads(printed)
