"""Errors of one-way delays while an assumption is violated, and the time for which such errors occur."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory

import others
from clocks import LOOP, VETH, Clocks, JudgedDelay, Path, Scene, slews, wire
from namespaces import Host, need_root
from programs import Program, output, peer
from report import Section, Table, micros

# Time from the start of the edge to a violation that begins later than the edge; half the duration
# if that is less.
BEGINS_S = 8.0
# Window of the estimator (`[clock] window_s`); wrong delays must end within it.
WINDOW_S = 10.0
# Length of a run. It exceeds BEGINS_S + WINDOW_S, because a shorter run always ends within the window.
QUICK_S = 20.0
FULL_S = 30.0
# A delay that is so much earlier than the violation cannot be in flight when the violation begins.
IN_FLIGHT_S = 0.5
PROBE_PORT = 8620
FORGER_PORT = 9999
# Packet mark of the forger's own probes, which are not redirected.
FORGER_MARK = 1
FORGED_MS = 13
# Jump of all clocks of a host, as after a pause of a virtual machine.
JUMP_S = 0.039
FALSE_TIME_S = -0.02


@dataclass(frozen=True)
class Case:
    """A violated assumption."""

    name: str
    path: Path
    scene: Scene
    # Time from the start of the edge to the violation.
    begins_s: float = 0.0
    # Context in which the scene runs.
    disturbance: Callable[[Host, Host], AbstractContextManager[object]] = lambda edge, cloud: nullcontext()


def prepare() -> None:
    need_root()
    others.prepare()


def measure(quick: bool) -> Section:
    section = Section("Violated assumptions")
    section.say(
        f"As above, with an assumption violated from the start or {BEGINS_S:g} s after it. *Wrong*: delays whose verdict is "
        "`ok` or `limited` and whose interval does not contain the truth, in both directions together; *until*: the last "
        "of them, after the violation began; *largest*: the largest distance of a truth from its interval, µs; *again*: the "
        f"first delay after the violation from which on 99 % are believed. The window is {WINDOW_S:g} s."
    )
    table = Table("violated", "path", "delays", "believed", "wrong", "until, s", "largest", "again, s")
    longest, early = 0.0, 0
    for case in _cases(QUICK_S if quick else FULL_S):
        print(f"  {case.name}, {case.path.name}", file=sys.stderr, flush=True)
        with case.path.hosts() as (edge, cloud), case.disturbance(edge, cloud):
            ways = case.scene.run(edge, cloud)
        delays = sorted((one for way in ways.values() for one in way), key=lambda one: one.at)
        longest = max(longest, _row(table, case, delays))
        early += sum(one.is_outside and one.at < case.begins_s - IN_FLIGHT_S for one in delays)
    section.table(table)
    section.aim("before an assumption is violated: no wrong delay", f"{early:,} wrong", early == 0)
    section.aim(
        f"a violated assumption: wrong delays for at most {WINDOW_S:g} s", f"{longest:.2f} s", longest <= WINDOW_S
    )
    return section


def _row(table: Table, case: Case, delays: list[JudgedDelay]) -> float:
    """Adds a row; returns the seconds from the beginning of the violation to its last wrong delay."""
    wrong = [one for one in delays if one.is_outside]
    until = max((one.at - case.begins_s for one in wrong), default=0.0)
    believed = sum(one.is_believed for one in delays)
    table.row(
        case.name,
        case.path.name,
        f"{len(delays):,}",
        f"{believed / len(delays):.1%}",
        f"{len(wrong):,}",
        f"{until:.2f}" if wrong else "–",
        micros(max(one.excess for one in wrong)) if wrong else "–",
        _again(case, delays),
    )
    return until


def _again(case: Case, delays: list[JudgedDelay]) -> str:
    """Returns the seconds from the beginning of the violation until 99 % of the delays are believed.

    Returns a dash if all delays after that beginning are believed.
    """
    after = [one for one in delays if one.at >= case.begins_s]
    if all(one.is_believed for one in after):
        return "–"
    first, doubted = len(after), 0
    for index in range(len(after) - 1, -1, -1):
        doubted += not after[index].is_believed
        if doubted <= 0.01 * (len(after) - index):
            first = index
    return "not again" if first == len(after) else f"{after[first].at - case.begins_s:.1f}"


def _cases(seconds: float) -> list[Case]:
    limit = "discipline = []\nmax_drift_ppm = 50.0"
    jump = Clocks(wall_steps=((BEGINS_S, JUMP_S),), raw_steps=((BEGINS_S, JUMP_S),))
    chrony = f'discipline = ["chrony"]\ndiscipline_interval_s = 0.5\n{others.chronyc_settings()}'
    return [
        Case("drift of 150 ppm, limit 50 ppm", wire(5, 40), Scene(Clocks(150.0, settings=limit), seconds)),
        Case("drift of 150 ppm, limit 50 ppm", VETH, Scene(Clocks(150.0, settings=limit), seconds)),
        Case("all clocks of a host jump by 39 ms", wire(20, 20), Scene(jump, seconds), BEGINS_S),
        Case("all clocks of a host jump by 39 ms", VETH, Scene(jump, seconds), BEGINS_S),
        Case("the wall clock is slewed by 500 and 40,000 ppm", wire(5, 40), Scene(Clocks(wall_steps=slews()), seconds)),
        Case(f"probes are forged by {FORGED_MS} ms", wire(20, 20), Scene(Clocks(), seconds), disturbance=_forging),
        Case(
            "one boot id, clocks 20 ms apart",
            LOOP,
            Scene(Clocks(), seconds, timestamps="user", false_time_s=FALSE_TIME_S),
        ),
        Case(
            "time daemons claim microseconds, the clocks are 10 ms apart",
            wire(5, 40),
            Scene(Clocks(ahead_s=0.01, discipline="unaware", settings=chrony), seconds),
            disturbance=others.daemons_with_small_claims,
        ),
    ]


@contextmanager
def _forging(edge: Host, cloud: Host) -> Iterator[None]:
    """Redirects the edge's probes to a program that alters their answers."""
    filter_ = (
        f"table ip forging {{ chain out {{ type nat hook output priority -100; "
        f"meta mark != {FORGER_MARK} udp dport {PROBE_PORT} redirect to :{FORGER_PORT}; }}; }}"
    )
    command = peer("forge_probes", "--listen", FORGER_PORT, "--reflector", f"{cloud.address}:{PROBE_PORT}")
    command += ["--add-ms", str(FORGED_MS), "--mark", str(FORGER_MARK)]
    with TemporaryDirectory(prefix="peernet-bench-") as folder:
        with Program(edge.inside(command), FilePath(folder, "log")) as forger:
            forger.wait_until("it forges", lambda: "forging" in forger.text())
            output(edge.inside(["nft", filter_]))
            yield
