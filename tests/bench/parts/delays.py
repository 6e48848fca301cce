"""Errors of one-way delays against the truth on several paths, compared with those of other programs."""

from __future__ import annotations

import sys

import others
from clocks import AHEAD_S, DIRECTIONS, HZ, VETH, Clocks, Errors, JudgedDelay, Path, Scene, slews, wire
from namespaces import Host, need_root
from report import Section, Table, micros

PATHS = (VETH, wire(1, 1), wire(5, 40), wire(20, 20), wire(5, 300))
DRIFTS_PPM = (0, 100, 200)
AIM_ERROR_S = 5e-6
AIM_WIDTH_S = 20e-6

Rows = list[tuple[str, dict[str, list[JudgedDelay]]]]


def prepare() -> None:
    need_root()
    others.prepare()


def measure(quick: bool) -> Section:
    seconds = 4 if quick else 12
    section = Section("Errors of one-way delays")
    section.say(
        f"1 kB, {HZ} times a second for {seconds} s, echoed. Both agents read the clocks of one kernel; those of the "
        f"edge are made {AHEAD_S * 1e3:g} ms ahead and drift as each row says. The true delay is known because "
        "both errors are known. No time daemon is asked, the drift limit is 200 ppm. Paths: up/down. *Saturated*: a second "
        "pipeline sends 1.2 MB back and forth as fast as it can. *Slewed*: the edge's wall clock runs 500 ppm fast for 4 s "
        "and 40,000 ppm for 1 s. Error: reported minus true, without its sign. Width: of the interval that is promised to contain the truth. All in µs."
    )
    table = Table("path, link, drift", "", "true p50", "error mean", "p99", "width p50", "believed", "outside")
    comparison = Table("path", "", "error mean", "width p50", "outside")
    # Errors of both directions, by names of path and scene.
    errors_by_scene: dict[str, list[Errors]] = {}
    for path in PATHS:
        print(f"  {path.name}", file=sys.stderr, flush=True)
        with path.hosts() as (edge, cloud):
            for name, scene in _scenes(path, seconds):
                errors = {way: Errors.of(delays) for way, delays in scene.run(edge, cloud).items()}
                errors_by_scene[f"{path.name}, {name}"] = list(errors.values())
                _rows(table, f"{path.name}, {name}", errors)
            _compare_others(comparison, path, errors_by_scene[f"{path.name}, idle, 0 ppm"], edge, cloud, seconds)
    section.table(table)
    section.say(
        "On the same paths, what a user gets elsewhere. *PEERNet*: idle, 0 ppm; the larger error and the larger "
        "width of both directions; *outside*: of both together. *chrony*: the stamps' difference minus the offset that chrony "
        "states; both clocks are equal, so each offset is an error. chrony follows the cloud's chronyd over the path "
        "with up to four polls a second; root delay and dispersion are the interval. *stamp-suite*: its one-way delays if "
        "the clocks are 500 ms apart; it assumes that they are equal. All in µs."
    )
    section.table(comparison)
    _aims(section, errors_by_scene)
    return section


def _scenes(path: Path, seconds: float) -> list[tuple[str, Scene]]:
    scenes = [
        (f"{'saturated' if saturated else 'idle'}, {drift} ppm", Scene(Clocks(drift), seconds, saturated=saturated))
        for saturated in (False, True)
        for drift in DRIFTS_PPM
    ]
    scenes.append(("slewed", Scene(Clocks(wall_steps=slews()), seconds)))
    if path == VETH:
        scenes.append(("idle, program's stamps", Scene(Clocks(), seconds, timestamps="user")))
    return scenes


def _rows(table: Table, name: str, errors: dict[str, Errors]) -> None:
    for way, error in errors.items():
        figures = map(micros, (error.truth, error.mean, error.p99, error.width))
        counts = f"{error.believed:,} of {error.count:,}", f"{error.outside} of {error.believed:,}"
        table.row(name if way == DIRECTIONS[0] else "", way, *figures, *counts)


def _compare_others(
    table: Table, path: Path, ours: list[Errors], edge: Host, cloud: Host, seconds: float
) -> None:
    up, down = ours
    error, width = max(up.mean, down.mean), max(up.width, down.width)
    table.row(path.name, "PEERNet", micros(error), micros(width), f"{up.outside + down.outside}")
    chrony = others.chrony(edge, cloud, seconds)
    table.row("", "chrony", micros(chrony.error), micros(chrony.width), f"{chrony.outside:.0%}")
    stamp = others.stamp_suite(edge, cloud, AHEAD_S, (up.truth, down.truth))
    table.row("", "stamp-suite", micros(stamp), "none", "–")


def _aims(section: Section, errors_by_scene: dict[str, list[Errors]]) -> None:
    every = [errors for directions in errors_by_scene.values() for errors in directions]
    outside, count = sum(one.outside for one in every), sum(one.believed for one in every)
    section.aim("one-way delays: the truth is inside the interval", f"{outside} of {count:,} outside", outside == 0)
    for drift in DRIFTS_PPM:
        quiet = errors_by_scene[f"veth, idle, {drift} ppm"]
        mean, width = max(one.mean for one in quiet), max(one.width for one in quiet)
        what = f"one-way delays, veth, idle, {drift} ppm"
        section.aim(f"{what}: mean error ≤ {micros(AIM_ERROR_S)} µs", f"{micros(mean)} µs", mean <= AIM_ERROR_S)
        section.aim(f"{what}: width p50 ≤ {micros(AIM_WIDTH_S)} µs", f"{micros(width)} µs", width <= AIM_WIDTH_S)
