"""The closed loop: an echo model over two network namespaces, compared with the paper's program's work and bare TCP."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from statistics import median

import contenders
from contenders import Arena, Shape, Slice
from namespaces import CONGESTION_CONTROL, need_root, two_hosts
from programs import ROOT
from quantiles import median_spread
from report import Section, Table, micros, rate, ratio, size, times

ECHO = (Shape(1_000), Shape(150_000), Shape(1_200_000))
# Typical offloading: large requests, small answers.
SMALL_ANSWER = (Shape(150_000, 64), Shape(1_200_000, 64))
STAGES = ("sensing", "encode", "upload", "queue", "inference", "download", "total", "unattributed")

# Smallest aimed-for ratio of PEERNet's rate to that of `published`.
RATE_AIM = 5.0
# Largest aimed-for ratio of PEERNet's upload to that of bare TCP, for uploads of FULL bytes.
UPLOAD_AIM = 1.15
FULL = 1_200_000

CONTENDERS: dict[str, Callable[[Arena, Shape], Slice]] = {
    "peernet": contenders.peernet,
    "published": contenders.published,
    "tcp": contenders.bare_tcp,
}


@dataclass
class Results:
    """All slices of one shape: a list per program, with one entry per repeat."""

    slices: dict[str, list[Slice]] = field(default_factory=lambda: {name: [] for name in CONTENDERS})
    # PEERNet's iterations per second without an aggregator, one entry per repeat.
    rates_without_aggregator: list[float] = field(default_factory=list)

    def rates(self, name: str) -> list[float]:
        return [one.rate for one in self.slices[name]]

    def medians(self, name: str, stage: str) -> list[float]:
        """Returns a program's medians of a stage, one per repeat, in seconds."""
        return [one.stages[stage]["p50"] for one in self.slices[name]]

    def spread(self, name: str, stage: str) -> dict[str, float] | None:
        """Returns the spread of a stage over all repeats; `None` if the program lacks the stage."""
        spreads = [one.stages[stage] for one in self.slices[name] if stage in one.stages]
        return median_spread(spreads) if spreads else None


def prepare() -> None:
    need_root()
    build = ["cargo", "build", "--release", "--locked", "--quiet", "--package", "peernet-tests", "--bin", "bare-tcp"]
    subprocess.run(build, cwd=ROOT, check=True)


def measure(quick: bool) -> Section:
    repeats, seconds = (1, 1) if quick else (7, 2)
    shapes = (*ECHO, *SMALL_ANSWER)
    results = {shape: Results() for shape in shapes}
    with two_hosts() as (edge, cloud):
        arena = Arena(edge, cloud, seconds)
        for repeat in range(repeats):
            for shape in shapes:
                _compare(arena, shape, repeat, results[shape])
            print(f"  repeat {repeat + 1} of {repeats}", file=sys.stderr, flush=True)
    section = Section("The closed loop")
    section.say(
        f"Two network namespaces joined by a veth pair (TCP {CONGESTION_CONTROL}); bytes go up, an echo model answers "
        f"with the same bytes or with 64. {repeats} repeats of {seconds} s each, one program after the other in turn; "
        "medians over the repeats, ratios taken repeat by repeat.\n\n"
        "- *PEERNet*: edge agent, cloud agent and aggregator; every iteration is stored in the database meanwhile.\n"
        "- *nothing stored*: the same two agents without an aggregator.\n"
        "- *published*: a Python program that does the published one's work per message (pyzmq PAIR, six nodes pickled "
        "with the data, sizes by pickling once more, a line of log, results rewritten every 1,000 iterations).\n"
        "- *bare TCP*: one blocking connection, two buffers used again and again, no headers, nothing measured but the "
        "delays."
    )
    _rates(section, results)
    _uploads(section, results)
    for shape in ECHO:
        _stages(section, shape, results[shape])
    missing = sum(one.missing for result in results.values() for one in result.slices["peernet"])
    section.say(f"Events measured but not stored, counted by the agents, over all of PEERNet's slices: {missing:,}.")
    return section


def _compare(arena: Arena, shape: Shape, repeat: int, results: Results) -> None:
    """Runs one slice of each program; the order rotates with each repeat."""
    names = list(CONTENDERS)
    first = repeat % len(names)
    for name in names[first:] + names[:first]:
        one = CONTENDERS[name](arena, shape)
        results.slices[name].append(one)
        if name == "peernet":
            iterations = max(1, round(one.rate * arena.seconds))
            results.rates_without_aggregator.append(contenders.peernet_alone(arena, shape, iterations))


def _rates(section: Section, results: dict[Shape, Results]) -> None:
    programs = ("PEERNet", "nothing stored", "published", "bare TCP")
    table = Table("iterations/s", *programs, "PEERNet to published", "bare TCP to published")
    for shape, result in results.items():
        ours, published, tcp = (result.rates(name) for name in CONTENDERS)
        gain = ratio(ours, published)
        rates = (rate(median(one)) for one in (ours, result.rates_without_aggregator, published, tcp))
        table.row(_name(shape), *rates, times(gain), times(ratio(tcp, published)))
        if shape in ECHO:
            promise = f"iterations per second at {size(shape.up)} ≥ {RATE_AIM:g} × the paper's program's"
            section.aim(promise, times(gain), gain >= RATE_AIM)
    section.table(table)


def _uploads(section: Section, results: dict[Shape, Results]) -> None:
    table = Table("upload, p50, µs", "PEERNet", "published", "bare TCP", "PEERNet to bare TCP")
    for shape, result in results.items():
        ours, published, tcp = (result.medians(name, "upload") for name in CONTENDERS)
        cost = ratio(ours, tcp)
        table.row(_name(shape), *(micros(median(one)) for one in (ours, published, tcp)), times(cost))
        if shape.up == FULL:
            promise = f"upload of {_name(shape)}: ≤ {UPLOAD_AIM:g} × bare TCP"
            section.aim(promise, times(cost), cost <= UPLOAD_AIM)
    section.table(table)


def _stages(section: Section, shape: Shape, result: Results) -> None:
    table = Table(f"{_name(shape)}, µs", "PEERNet p50", "p99", "published p50", "p99", "bare TCP p50", "p99")
    for stage in STAGES:
        cells = []
        for name in CONTENDERS:
            spread = result.spread(name, stage) or {}
            cells += [micros(spread.get("p50")), micros(spread.get("p99"))]
        table.row(stage, *cells)
    section.table(table)


def _name(shape: Shape) -> str:
    return f"{size(shape.up)}, echo" if shape.answer is None else f"{size(shape.up)} up, {size(shape.answer)} down"
