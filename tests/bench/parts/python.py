"""Custom Python objects: cost of a call to their process, and the commands of the paper's program with such objects."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

import contenders
from contenders import Arena, Shape
from namespaces import CONGESTION_CONTROL, need_root, two_hosts
from programs import HERE, PEERNET, ROOT, Failure, Program, output
from quantiles import median_spread, spread
from report import Section, Table, micros, rate, ratio, size, times

SIZES = (1_000, 150_000, 1_200_000)
OBJECTS = HERE / "objects"
CALL_BENCH = ["cargo", "bench", "--locked", "--quiet", "--package", "peernet-external", "--bench", "python"]
# The Python of the benchmarks, which has numpy.
PYTHON = f"PEERNET_PYTHON={sys.executable}"
# Iterations in which caches fill and the clock offset is first estimated; their rows are left out.
WARM_UP = 200
NAMES = ("sensing", "capture_capture-ipc", "upload", "ipc", "inference", "download", "total", "unattributed")

RATE_AIM = 1.0

Stages = dict[str, dict[str, float]]


def prepare() -> None:
    need_root()
    if not PEERNET.exists():
        raise Failure(f"{PEERNET} does not exist; build it with cargo build --release --package peernetd")
    subprocess.run([*CALL_BENCH, "--no-run"], cwd=ROOT, check=True)


def measure(quick: bool) -> Section:
    section = Section("Python objects")
    _measure_calls(section, 200 if quick else 5000)
    repeats, seconds = (1, 1) if quick else (7, 2)
    ours: dict[int, list[float]] = {bytes_: [] for bytes_ in SIZES}
    theirs: dict[int, list[float]] = {bytes_: [] for bytes_ in SIZES}
    stages: dict[int, list[Stages]] = {bytes_: [] for bytes_ in SIZES}
    with two_hosts() as (edge, cloud):
        arena = Arena(edge, cloud, seconds)
        for repeat in range(repeats):
            for bytes_ in SIZES:
                published = contenders.published(arena, Shape(bytes_)).rate
                own, spreads = _commands(arena, bytes_, max(WARM_UP, round(published * seconds)))
                theirs[bytes_].append(published)
                ours[bytes_].append(own)
                stages[bytes_].append(spreads)
            print(f"  repeat {repeat + 1} of {repeats}", file=sys.stderr, flush=True)
    section.say(
        "`peernet --server --model-name echo::Echo` and `peernet --client --sensor-object echo::Source` in two network "
        f"namespaces (TCP {CONGESTION_CONTROL}): a Python sensor yields bytes, a Python model returns them, results "
        "are written meanwhile. Compared with the Python program that does the published one's work, where sensor and "
        f"model are part of the program's own process. {repeats} repeats of about {seconds} s each, in turn; "
        "medians over the repeats, ratios taken repeat by repeat."
    )
    table = Table("iterations/s", "PEERNet, Python objects", "published", "to published")
    for bytes_ in SIZES:
        gain = ratio(ours[bytes_], theirs[bytes_])
        table.row(size(bytes_), rate(median(ours[bytes_])), rate(median(theirs[bytes_])), times(gain))
        promise = f"iterations/s with Python objects at {size(bytes_)} ≥ {RATE_AIM:g} × the paper's program's"
        section.aim(promise, times(gain), gain >= RATE_AIM)
    section.table(table)
    table = Table("p50, µs", *(size(bytes_) for bytes_ in SIZES))
    for name in NAMES:
        cells = []
        for bytes_ in SIZES:
            spreads = [one[name] for one in stages[bytes_] if name in one]
            cells.append(micros(median_spread(spreads)["p50"] if spreads else None))
        table.row(name, *cells)
    section.table(table)
    return section


def _measure_calls(section: Section, rounds: int) -> None:
    """Measures calls to an object in a process, and the same calls with `cat` in place of the object."""
    command = ["env", PYTHON, *CALL_BENCH, "--", "--json", rounds]
    rows = json.loads(output(command, folder=ROOT, timeout_s=600))
    section.say(
        "What a call costs beyond the custom code: a round trip to an object that returns what it got, "
        f"{rounds} rounds, against the same bytes through `cat`."
    )
    table = Table("µs", "cat p50", "p99", "bytes p50", "p99", "array p50", "p99")
    for bytes_ in SIZES:
        found = {row["what"]: row for row in rows if row["bytes"] == bytes_}
        cells = [micros(found[what][key]) for what in ("cat", "bytes", "array") for key in ("p50_s", "p99_s")]
        table.row(size(bytes_), *cells)
    section.table(table)


def _commands(arena: Arena, bytes_: int, iterations: int) -> tuple[float, Stages]:
    """Runs the commands of the paper's program with Python objects. Returns iterations per second and stages."""
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder:
        network = Path(folder, "net_config.yaml")
        network.write_text(
            f"devices:\n  edge: {arena.edge.address}\n  cloud: {arena.cloud.address}\nserver: cloud\n"
        )
        common = ["--network", "zmq-tcp", "--network-config", network]
        server = [PEERNET, "--server", "--name", "cloud", *common, "--model-name", "echo::Echo", "--device", "cpu"]
        # The server is stopped after the client has ended, so the number only has to be large enough.
        server += ["--iterations", 1_000_000_000, "--quiet"]
        client = [PEERNET, "--client", "--name", "edge", *common, "--sensor-object", "echo::Source", "--quiet"]
        client += ["--iterations", iterations + WARM_UP, "--result-loc", f"{folder}/results"]
        environment = ["env", f"BENCH_BYTES={bytes_}", PYTHON]
        command = arena.cloud.inside([*environment, *server])
        with Program(command, Path(folder, "server.log"), folder=OBJECTS):
            output(arena.edge.inside([*environment, *client]), folder=OBJECTS, timeout_s=60 + 20 * arena.seconds)
        with Path(folder, "results/data.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))[WARM_UP:]
    if bad := [row for row in rows if row["outcome"] != "ok"]:
        raise Failure(f"{len(bad)} iterations of {bytes_} bytes did not go well: {bad[0]['reason']}")
    elapsed = float(rows[-1]["at"]) + float(rows[-1]["total"]) - float(rows[0]["at"])
    spreads = {name: spread(float(row[name]) for row in rows if row[name]) for name in NAMES if rows[0].get(name)}
    return len(rows) / elapsed, spreads
