"""All networks side by side: the same echo over each, beside the bare transports and the tools of ROS."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from dataclasses import dataclass, field
from statistics import median

import transports
from contenders import WARM_UP, Arena, Shape, Slice
from namespaces import Host, need_root, two_distant_hosts, two_hosts
from programs import ROOT
from quantiles import median_spread
from report import Section, Table, micros, rate, ratio, size, times

SIZES = (1_000, 150_000, 1_200_000)

# Iterations before the first that counts, on a link on which each may take a quarter of a second.
SLOW_WARM_UP = 10

# Contender, the contender that it is compared with, and smallest aimed-for ratio of their rates.
AIMS = (
    ("zmq-tcp", "bare TCP", 0.9),
    ("zmq-udp", "bare UDP", 0.7),
    ("ros1", "rospy", 2.0),
    ("ros1", "roslibrust", 1.0),
    ("ros2", "rustdds", 0.9),
)


@dataclass
class Results:
    """The slices of all contenders at one size, a list per contender, one entry per repeat."""

    slices: dict[str, list[Slice]] = field(default_factory=dict)

    def rates(self, name: str) -> list[float]:
        return [one.rate for one in self.slices[name]]


@dataclass(frozen=True)
class Link:
    """What is between the two hosts."""

    name: str
    # `None`: a veth pair without limit and delay.
    bits_per_second: int | None
    # Delay of each direction.
    delay_ms: int
    # Duration and number of the slices of each contender.
    seconds: int
    repeats: int


LINKS = (
    Link("veth", bits_per_second=None, delay_ms=0, seconds=2, repeats=5),
    Link("100 Mbit/s, 5 ms", bits_per_second=100_000_000, delay_ms=5, seconds=4, repeats=3),
)


def prepare() -> None:
    need_root()
    transports.prepare()
    build = ["cargo", "build", "--release", "--quiet"]
    # One command builds both packages, because cargo chooses the features of their dependencies for each command.
    ours = [*build, "--locked", "--package", "peernetd", "--package", "peernet-tests", "--bins"]
    subprocess.run([*ours, "--features", "peernetd/ros2,peernet-tests/ros2"], cwd=ROOT, check=True)
    foreign = ["--manifest-path", "tests/bench/roslibrust/Cargo.toml", "--target-dir", "target/interop"]
    subprocess.run([*build, *foreign], cwd=ROOT, check=True)


def measure(quick: bool) -> Section:
    section = Section("Networks")
    section.say(
        "An edge sends the bytes that each table names and an echo model returns them, one iteration after the other; "
        "edge agent, cloud agent and aggregator, every iteration stored. Without PEERNet: a ping-pong over one "
        "TCP connection, one over UDP with datagrams of zmq-udp's length, and round trips between two nodes of rospy, of roslibrust and of "
        "rustdds. Medians over the "
        "repeats, one program after the other in turn; ratios taken repeat by repeat. Processor time: both agents, or both "
        "programs, per gigabyte in either direction. Answers in percent of what was sent."
    )
    for link in LINKS:
        _link(section, link, quick)
    return section


def _link(section: Section, link: Link, quick: bool) -> None:
    repeats, seconds = (1, 1) if quick else (link.repeats, link.seconds)
    results = {bytes_: Results() for bytes_ in SIZES}
    names = list(transports.CONTENDERS)
    with _hosts(link) as (edge, cloud), transports.Shared(edge, cloud) as shared:
        arena = Arena(edge, cloud, seconds, WARM_UP if link.bits_per_second is None else SLOW_WARM_UP)
        for repeat in range(repeats):
            for bytes_, result in results.items():
                first = repeat % len(names)
                for name in names[first:] + names[:first]:
                    one = transports.CONTENDERS[name](arena, shared, Shape(bytes_))
                    result.slices.setdefault(name, []).append(one)
            print(f"  {link.name}: repeat {repeat + 1} of {repeats}", file=sys.stderr, flush=True)
    for bytes_, result in results.items():
        _table(section, link, bytes_, result)
    if link.bits_per_second:
        # The link limits the rates of all contenders, so their ratios say little about the contenders.
        return
    for contender, other, least in AIMS:
        for bytes_, result in results.items():
            share = ratio(result.rates(contender), result.rates(other))
            promise = f"{link.name}, {size(bytes_)}: {contender} ≥ {least:g} × {other}"
            section.aim(promise, times(share), share >= least)


def _hosts(link: Link) -> contextlib.AbstractContextManager[tuple[Host, Host]]:
    if link.bits_per_second is None:
        return two_hosts()
    return two_distant_hosts(link.delay_ms, link.delay_ms, link.bits_per_second)


def _table(section: Section, link: Link, bytes_: int, result: Results) -> None:
    table = Table(
        f"{link.name}, {size(bytes_)}",
        "iterations/s",
        "upload p50, µs",
        "p99, µs",
        "round trip p50, µs",
        "p99, µs",
        "CPU s/GB",
        "answered",
    )
    for name, slices in result.slices.items():
        upload = [one.stages["upload"] for one in slices if "upload" in one.stages]
        total = median_spread([one.stages["total"] for one in slices])
        up = median_spread(upload) if upload else {}
        answered = sum(one.answered for one in slices) / max(1, sum(one.sent for one in slices))
        table.row(
            name,
            rate(median(one.rate for one in slices)),
            micros(up.get("p50")),
            micros(up.get("p99")),
            micros(total["p50"]),
            micros(total["p99"]),
            f"{median(one.cpu_seconds / (one.sent * 2 * bytes_ * 1e-9) for one in slices):.2f}",
            f"{answered:.2%}",
        )
    section.table(table)
