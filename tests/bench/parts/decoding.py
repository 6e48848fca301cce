"""Decoding of the pictures of a batch, on one thread or on all."""

from __future__ import annotations

import os
from statistics import median

import graphs
from deployment import Deployment, deployment, free_ports
from experiments import Run, cloud, need_peernet, run_experiment
from programs import ROOT, Failure
from report import Section, Table, micros, ratio, times

MODEL = ROOT / "models/quality-control"
BATCH = 8
# Threads of the agent's decoder: as many as it uses by default, and one.
ALL, ONE = "all", "one"
ENVIRONMENTS = {ALL: {}, ONE: {"RAYON_NUM_THREADS": "1"}}
WARM_UP = 5


def prepare() -> None:
    need_peernet()
    if not (MODEL / "model.onnx").exists():
        raise Failure(f"{MODEL}/model.onnx does not exist: it belongs to the checkout")


def measure(quick: bool) -> Section:
    repeats, seconds = (2, 3) if quick else (5, 6)
    with deployment() as daemons:
        graphs.copy_with_open_batch(MODEL, daemons.folder / "open-batch")
        ports = dict(zip(ENVIRONMENTS, free_ports(len(ENVIRONMENTS)), strict=True))
        with (
            cloud(daemons.folder, ports[ALL], _model(daemons), environment=ENVIRONMENTS[ALL]),
            cloud(daemons.folder, ports[ONE], _model(daemons), environment=ENVIRONMENTS[ONE]),
        ):
            text = _experiment(ports, repeats, seconds)
            runs = run_experiment(daemons.folder, "decoding", text, timeout_s=120 + repeats * 2 * (seconds + 60))
    return _section(runs, repeats, seconds)


def _section(runs: list[Run], repeats: int, seconds: int) -> Section:
    section = Section("Decoding the pictures of a batch")
    section.say(
        f"An agent computes batches of {BATCH}; as many users send JPEG files of 1280 × 960 pixels in a closed loop. Only "
        f"full batches count. With *one* thread, `RAYON_NUM_THREADS=1` is set for the agent; with *all*, {os.cpu_count()}. "
        f"{repeats} repeats of {seconds} s of each, in random order within each repeat; medians over the repeats, ratios "
        "taken repeat by repeat."
    )
    table = Table("µs", "one thread", "all threads", "all to one")
    for column in ("preprocessing", "inference", "total"):
        sides = [[_median(runs, name, repeat, column) for repeat in range(repeats)] for name in (ONE, ALL)]
        table.row(column, *(micros(median(side)) for side in sides), times(ratio(sides[1], sides[0])))
    section.table(table)
    return section


def _median(runs: list[Run], name: str, repeat: int, column: str) -> float:
    rows = [
        row
        for run in runs
        if run.configuration == {"Threads": name} and run.repeat == repeat
        for row in run.rows
        if float(row["inference_batch-size"]) == BATCH
    ]
    if not rows:
        raise Failure(f"repeat {repeat} with {name} threads has no batch of {BATCH}")
    return median(float(row[column]) for row in rows)


def _model(daemons: Deployment) -> str:
    return f"""
[[model]]
name = "quality-control"
kind = "onnx"
path = "{daemons.folder}/open-batch"
intra_threads = 1
inter_threads = 1
queue = 64
batch = {{ max_size = {BATCH}, max_wait_ms = 100 }}
"""


def _experiment(ports: dict[str, int], repeats: int, seconds: int) -> str:
    values = "".join(
        f'[[axis.value]]\nlabel = "{name}"\nset = {{ "pipeline.placement.peer" = "tcp://127.0.0.1:{port}" }}\n'
        for name, port in ports.items()
    )
    return f"""
[experiment]
duration_s = {seconds}.0
repeats = {repeats}
users = {BATCH}
warm_up = {{ iterations = {WARM_UP} }}
[pipeline]
sensor = {{ kind = "images", path = "{MODEL}/pictures" }}
placement = {{ kind = "remote", model = "quality-control" }}
load = {{ mode = "closed" }}
[[axis]]
name = "Threads"
{values}
"""
