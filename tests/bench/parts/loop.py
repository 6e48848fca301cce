"""The closed loop: an echo model over two network namespaces, beside the published program's work and bare TCP."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

import contenders
from contenders import Arena, Shape, Slice
from namespaces import need_root, two_hosts
from programs import ROOT
from quantiles import median_spread
from report import Section, Table, micros, rate, ratio, size, times

ECHO = (Shape(1_000), Shape(150_000), Shape(1_200_000))
# What offloading usually looks like: much goes up, little comes down.
SMALL_ANSWER = (Shape(150_000, 64), Shape(1_200_000, 64))
STAGES = ("encode", "send-queue", "upload", "queue", "inference", "download", "total", "unattributed")

RATE_AIM = 5.0
UPLOAD_AIM = 1.15
FULL = 1_200_000

CONTENDERS: dict[str, Callable[[Arena, Shape], Slice]] = {
    "peernet": contenders.peernet,
    "published": contenders.published,
    "lean": lambda arena, shape: contenders.published(arena, shape, lean=True),
    "tcp": contenders.bare_tcp,
}


@dataclass
class Results:
    """All slices of one shape, a list per contender, one entry per repeat."""

    slices: dict[str, list[Slice]] = field(default_factory=lambda: {name: [] for name in CONTENDERS})
    alone: list[float] = field(default_factory=list)

    def rates(self, name: str) -> list[float]:
        return [one.rate for one in self.slices[name]]

    def stage(self, name: str, stage: str) -> list[float]:
        return [one.stages[stage]["p50"] for one in self.slices[name]]

    def spread(self, name: str, stage: str) -> dict[str, float] | None:
        spreads = [one.stages[stage] for one in self.slices[name] if stage in one.stages]
        return median_spread(spreads) if spreads else None


def prepare() -> None:
    need_root()
    build = ["cargo", "build", "--release", "--locked", "--quiet", "--package", "peernet-tests", "--bin", "bare-tcp"]
    subprocess.run(build, cwd=ROOT, check=True)


def measure(quick: bool) -> Section:
    repeats, seconds = (1, 1) if quick else (9, 2)
    section = Section("The closed loop")
    with two_hosts() as (edge, cloud):
        arena = Arena(edge, cloud, seconds)
        results = {shape: _compare(arena, shape, repeats) for shape in (*ECHO, *SMALL_ANSWER)}
    section.say(
        "Two network namespaces joined by a veth pair; bytes go up, an echo model answers with the same bytes or with "
        f"64. {repeats} repeats of {seconds} s each, one program after the other in turn; medians over the repeats, "
        "ratios taken repeat by repeat.\n\n"
        "- *PEERNet*: edge agent, cloud agent and aggregator; every iteration is stored in the database meanwhile.\n"
        "- *without aggregator*: the same two agents, nothing stored.\n"
        "- *published*: a Python program that does the published one's work per message (pyzmq PAIR, six nodes pickled "
        "with the data, sizes by pickling once more, a line of log, results rewritten every 1,000 iterations).\n"
        "- *lean*: the same without log, polling and results.\n"
        "- *bare TCP*: one blocking connection, two buffers used again and again, no headers, nothing measured but the "
        "delays."
    )
    _rates(section, results)
    _uploads(section, results)
    for shape in ECHO:
        _stages(section, shape, results[shape])
    dropped = sum(one.missing for result in results.values() for one in result.slices["peernet"])
    section.say(f"Iterations measured but not stored, over all of PEERNet's slices: {dropped:,}.")
    return section


def _compare(arena: Arena, shape: Shape, repeats: int) -> Results:
    results = Results()
    names = list(CONTENDERS)
    for repeat in range(repeats):
        for name in names[repeat % len(names) :] + names[: repeat % len(names)]:
            results.slices[name].append(CONTENDERS[name](arena, shape))
            if name == "peernet":
                iterations = max(1, round(results.slices[name][-1].rate * arena.seconds))
                results.alone.append(contenders.peernet_alone(arena, shape, iterations))
    return results


def _rates(section: Section, results: dict[Shape, Results]) -> None:
    table = Table(
        "iterations per second",
        "PEERNet",
        "without aggregator",
        "published",
        "lean",
        "bare TCP",
        "to published",
        "to lean",
    )
    for shape, result in results.items():
        ours = result.rates("peernet")
        gain = ratio(ours, result.rates("published"))
        table.row(
            _name(shape),
            rate(median(ours)),
            rate(median(result.alone)),
            *(rate(median(result.rates(name))) for name in ("published", "lean", "tcp")),
            times(gain),
            times(ratio(ours, result.rates("lean"))),
        )
        if shape in ECHO:
            promise = f"iterations per second at {size(shape.up)} ≥ {RATE_AIM:g} × the published program's"
            section.aim(promise, times(gain), gain >= RATE_AIM)
    section.table(table)


def _uploads(section: Section, results: dict[Shape, Results]) -> None:
    table = Table("upload, p50, µs", "PEERNet", "bare TCP", "to bare TCP", "published", "lean")
    for shape, result in results.items():
        cost = ratio(result.stage("peernet", "upload"), result.stage("tcp", "upload"))
        ours, tcp, published, lean = (
            median(result.stage(name, "upload")) for name in ("peernet", "tcp", "published", "lean")
        )
        table.row(_name(shape), micros(ours), micros(tcp), times(cost), micros(published), micros(lean))
        if shape.up == FULL:
            promise = f"upload of {_name(shape)} ≤ {UPLOAD_AIM:g} × bare TCP"
            section.aim(promise, times(cost), cost <= UPLOAD_AIM)
    section.table(table)


def _stages(section: Section, shape: Shape, result: Results) -> None:
    table = Table(f"{_name(shape)}, µs", "PEERNet p50", "p99", "published p50", "p99", "bare TCP p50", "p99")
    for stage in STAGES:
        cells = []
        for name in ("peernet", "published", "tcp"):
            spread = result.spread(name, stage) or {}
            cells += [micros(spread.get("p50")), micros(spread.get("p99"))]
        table.row(stage, *cells)
    section.table(table)


def _name(shape: Shape) -> str:
    return f"{size(shape.up)}, echo" if shape.answer is None else f"{size(shape.up)} up, {size(shape.answer)} down"
