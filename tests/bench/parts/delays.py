"""Errors of one-way delays: what is reported, against the truth that two hosts on one kernel's clock allow to know."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import fmean

import store
from namespaces import Host, need_root, two_hosts
from plant import LOOPBACK, Plant, free_ports, plant
from programs import Failure
from quantiles import quantile
from report import Section, Table, micros

DIRECTIONS = ("upload", "download")
HZ = 100
AIM_S = 50e-6


@dataclass(frozen=True)
class Case:
    """What one row of the table is about."""

    cable: str
    saturated: bool
    timestamps: str

    def words(self) -> str:
        return f"{self.cable}, {'saturated' if self.saturated else 'idle'}, {self.timestamps}"


CASES = tuple(
    Case(cable, saturated, timestamps)
    for cable in ("loopback", "veth")
    for saturated in (False, True)
    for timestamps in ("kernel", "user")
)


def prepare() -> None:
    need_root()


def measure(quick: bool) -> Section:
    seconds = 3 if quick else 20
    section = Section("Errors of one-way delays")
    section.say(
        f"1 kB, {HZ} times a second for {seconds} s, echoed. Both agents read the kernel's clock, which is the truth, "
        "but count as two clocks, of which nothing is known but the exchanges between them (no time daemon's word, "
        "drift limit 50 ppm). *Saturated*: a second pipeline sends 1.2 MB back and forth as fast as it can. Stamps of "
        "probes by the kernel, or by the program alone. Error: reported minus true, without its sign. Width: of the "
        "interval that is promised to contain the truth. All in µs."
    )
    table = Table("cable, link, stamps", "", "true p50", "error mean", "p50", "p99", "width p50", "outside")
    seen: list[tuple[Case, Errors]] = []
    for case in CASES:
        print(f"  {case.words()}", file=sys.stderr, flush=True)
        for direction, delays in _run(case, seconds).items():
            if not delays:
                raise Failure(f"{case.words()}: no {direction} was given a value")
            errors = Errors.of(delays)
            seen.append((case, errors))
            _row(table, case.words() if direction == DIRECTIONS[0] else "", direction, errors)
    section.table(table)
    outside = sum(errors.outside for _, errors in seen)
    count = sum(errors.count for _, errors in seen)
    section.aim("one-way delays: the truth is inside the interval", f"{outside} of {count:,} outside", outside == 0)
    mean = max(errors.mean for case, errors in seen if case.cable == "veth" and not case.saturated)
    section.aim(f"one-way delays, veth, idle: mean error ≤ {micros(AIM_S)} µs", f"{micros(mean)} µs", mean <= AIM_S)
    return section


@dataclass(frozen=True)
class Errors:
    """Seconds, but for the counts."""

    count: int
    outside: int
    truth: float
    mean: float
    p50: float
    p99: float
    width: float

    @classmethod
    def of(cls, delays: list[store.Delay]) -> Errors:
        errors = sorted(abs(one.value - one.raw) for one in delays)
        return cls(
            len(delays),
            # Stored in seconds with 53 bits: two nanoseconds are rounding.
            sum(not one.lo - 2e-9 <= one.raw <= one.hi + 2e-9 for one in delays),
            quantile(sorted(one.raw for one in delays), 0.5),
            fmean(errors),
            quantile(errors, 0.5),
            quantile(errors, 0.99),
            quantile(sorted(one.hi - one.lo for one in delays), 0.5),
        )


def _row(table: Table, case: str, direction: str, errors: Errors) -> None:
    figures = (errors.truth, errors.mean, errors.p50, errors.p99, errors.width)
    table.row(case, direction, *map(micros, figures), f"{errors.outside} of {errors.count:,}")


def _run(case: Case, seconds: int) -> dict[str, list[store.Delay]]:
    with _hosts(case.cable) as (edge, cloud), plant() as it:
        events, web, data = free_ports(3)
        it.aggregator(edge, events=events, web=web)
        it.daemon("cloud", _cloud(it, case, cloud, data), cloud)
        text = _edge(it, case, f"tcp://{edge.address}:{events}", f"{cloud.address}:{data}", seconds)
        agent = it.daemon("edge", text, edge)
        agent.wait_until("its run is stored", lambda: it.is_stored("small"), seconds + 60)
        run = store.run_of(it.database, "small")
        if run is None:
            raise Failure("the run that was stored is gone")
        return {direction: store.delays(it.database, run, direction) for direction in DIRECTIONS}


@contextmanager
def _hosts(cable: str) -> Iterator[tuple[Host, Host]]:
    if cable == "loopback":
        yield LOOPBACK, LOOPBACK
    else:
        with two_hosts() as hosts:
            yield hosts


def _agent(it: Plant, case: Case, name: str, more: str) -> str:
    return f"""
        [agent]
        name = "{name}"
        state_dir = "{it.folder}/{name}"
        clock_identity = "{name}"
        {more}
        [clock]
        timestamps = "{case.timestamps}"
        discipline = []
    """


def _cloud(it: Plant, case: Case, host: Host, data: int) -> str:
    return f"""
        {_agent(it, case, "cloud", "")}
        [serve]
        listen = "tcp://{host.address}:{data}"
        [[model]]
        name = "echo"
        kind = "echo"
    """


def _edge(it: Plant, case: Case, aggregator: str, peer: str, seconds: int) -> str:
    pipelines = _pipeline("small", peer, 1000, f'load = {{ mode = "rate", hz = {HZ:.1f} }}', seconds)
    if case.saturated:
        pipelines += _pipeline("images", peer, 1_200_000, "", seconds + 2)
    return _agent(it, case, "edge", f'aggregator = "{aggregator}"') + pipelines


def _pipeline(name: str, peer: str, size: int, load: str, seconds: int) -> str:
    return f"""
        [[pipeline]]
        name = "{name}"
        sensor = {{ kind = "synthetic", size_bytes = {size} }}
        placement = {{ kind = "remote", peer = "tcp://{peer}", model = "echo" }}
        limit = {{ duration_s = {seconds:.1f} }}
        {load}
    """
