"""Concurrent requests of several users, computed one by one or together in batches."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from statistics import median

from PIL import Image

import graphs
from deployment import Deployment, deployment, free_ports
from experiments import Run, cloud, need_peernet, run_experiment
from programs import ROOT, Failure
from quantiles import spread
from report import Section, Table, micros, rate, ratio, times

MODEL = ROOT / "models/quality-control"
# Width and height of the model's input. Pictures of this size need little preprocessing.
SIZE = (224, 168)
USERS = (1, 4, 16)
OFF, ON = "off", "on"
BATCH = "batch = { max_size = 8, max_wait_ms = 5 }"
MODELS = {OFF: "", ON: BATCH}
BATCH_SIZES = (1, 4, 8)
WARM_UP = 20


@dataclass(frozen=True)
class CombinedUsers:
    """Answers per second and total (seconds) of all users of a run, over the time in which all of them measured."""

    rate: float
    p50: float
    p99: float


def prepare() -> None:
    need_peernet()
    if not (MODEL / "model.onnx").exists():
        raise Failure(f"{MODEL}/model.onnx does not exist: it belongs to the checkout")


def measure(quick: bool) -> Section:
    repeats, seconds = (2, 2) if quick else (5, 5)
    with deployment() as daemons:
        graphs.copy_with_open_batch(MODEL, daemons.folder / "open-batch")
        model_times = graphs.seconds_per_sample(daemons.folder / "open-batch", BATCH_SIZES, 10 if quick else 100)
        _shrink(MODEL / "pictures", daemons.folder / "pictures")
        (port,) = free_ports(1)
        models = "".join(_model(daemons, name, batch_line) for name, batch_line in MODELS.items())
        with cloud(daemons.folder, port, models):
            text = _experiment(daemons, port, repeats, seconds)
            timeout_s = 120 + repeats * len(MODELS) * len(USERS) * (seconds + 60)
            runs = run_experiment(daemons.folder, "batching", text, timeout_s=timeout_s)
    return _section(runs, model_times, repeats, seconds)


def _section(runs: list[Run], model_times: dict[int, float], repeats: int, seconds: int) -> Section:
    section = Section("Batches")
    section.say(
        f"An agent offers `quality-control` twice, with and without `{BATCH}`; the first dimension of its graph, the batch, is open. "
        "One worker, one thread, all processes on one machine. Each user is a process of `peernet run`, which sends JPEG "
        f"files of {SIZE[0]} × {SIZE[1]} pixels in a closed loop. {repeats} repeats of {seconds} s of each "
        "configuration, in random order within each repeat; only the time in which all users measured counts. Medians "
        "over the repeats, ratios taken repeat by repeat."
    )
    cells = {(name, users): _cell(runs, name, users, repeats) for users in USERS for name in MODELS}
    table = Table(
        "users", "answers/s off", "on", "on to off", "total p50, µs, off", "on", "p99 off", "on", "on to off"
    )
    for users in USERS:
        off, on = cells[OFF, users], cells[ON, users]
        rates, p50s, p99s = (
            [[getattr(one, key) for one in side] for side in (off, on)] for key in ("rate", "p50", "p99")
        )
        table.row(
            users,
            *(rate(median(side)) for side in rates),
            times(ratio(rates[1], rates[0])),
            *(micros(median(side)) for side in p50s),
            *(micros(median(side)) for side in p99s),
            times(ratio(p99s[1], p99s[0])),
        )
    section.table(table)
    section.say(
        "Largest possible gain by batches: median time per sample in Python's onnxruntime with one thread, "
        + ", ".join(f"{micros(one)} µs in a batch of {size}" for size, one in model_times.items())
        + "."
    )
    for users in USERS:
        if recorded := _recorded(runs, users):
            section.say(f"Medians of the columns about batches with {users} users: {recorded}.")
    return section


def _cell(runs: list[Run], name: str, users: int, repeats: int) -> list[CombinedUsers]:
    """Returns the figures of one configuration, one item for each repeat."""
    chosen = [run for run in runs if run.configuration == {"Batches": name, "Users": str(users)}]
    cell = []
    for repeat in range(repeats):
        edges = [run for run in chosen if run.repeat == repeat]
        if len(edges) != users:
            raise Failure(f"repeat {repeat} with {users} users and batches {name} has {len(edges)} results")
        cell.append(_combine(edges))
    return cell


def _combine(edges: list[Run]) -> CombinedUsers:
    # Start and total of each iteration, by user.
    iterations = [[(float(row["at"]), float(row["total"])) for row in run.rows] for run in edges]
    begin = max(one[0][0] for one in iterations)
    end = min(at + total for at, total in (one[-1] for one in iterations))
    totals = [total for one in iterations for at, total in one if at >= begin and at + total <= end]
    if not totals:
        raise Failure(f"{len(edges)} users measured at different times, so no iteration counts")
    figures = spread(totals)
    return CombinedUsers(len(totals) / (end - begin), figures["p50"], figures["p99"])


def _recorded(runs: list[Run], users: int) -> str:
    """Returns the medians of all columns about batches, over the runs with batches."""
    rows = [row for run in runs if run.configuration == {"Batches": ON, "Users": str(users)} for row in run.rows]
    columns = sorted({column for row in rows for column in row if "batch" in column})
    medians = {column: [float(row[column]) for row in rows if row.get(column)] for column in columns}
    return ", ".join(f"`{column}` {median(values):g}" for column, values in medians.items() if values)


def _model(daemons: Deployment, name: str, batch_line: str) -> str:
    return f"""
[[model]]
name = "{name}"
kind = "onnx"
path = "{daemons.folder}/open-batch"
intra_threads = 1
inter_threads = 1
queue = 64
{batch_line}
"""


def _experiment(daemons: Deployment, port: int, repeats: int, seconds: int) -> str:
    values = "".join(
        f'[[axis.value]]\nlabel = "{name}"\nset = {{ "pipeline.placement.model" = "{name}" }}\n' for name in MODELS
    )
    return f"""
[experiment]
duration_s = {seconds}.0
repeats = {repeats}
warm_up = {{ iterations = {WARM_UP} }}
[pipeline]
sensor = {{ kind = "images", path = "{daemons.folder}/pictures" }}
placement = {{ kind = "remote", peer = "tcp://127.0.0.1:{port}" }}
load = {{ mode = "closed" }}
[[axis]]
name = "Users"
field = "experiment.users"
values = [{", ".join(map(str, USERS))}]
[[axis]]
name = "Batches"
{values}
"""


def _shrink(source: Path, target: Path) -> None:
    target.mkdir()
    for path in sorted(source.glob("*.jpg")):
        with Image.open(path) as picture:
            picture.resize(SIZE, Image.BILINEAR).save(target / path.name, quality=95)
