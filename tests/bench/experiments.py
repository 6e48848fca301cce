"""Experiments of `peernet run`: their configuration, their execution and the rows of their results."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from contenders import LISTENING, sees
from programs import PEERNET, PEERNETD, ROOT, Failure, Program, output
from quantiles import spread

RECORDER = ROOT / "docs/examples/external/record.sh"
ONNX_RUNTIME = ROOT / "onnxruntime/lib/libonnxruntime.so"

Stages = dict[str, dict[str, float]]
Row = dict[str, str]


@dataclass(frozen=True)
class Run:
    """One run of an experiment, or the share of one user in it."""

    # Labels by the names of the axes.
    configuration: dict[str, str]
    repeat: int
    # Iterations after the warm-up, in their order.
    rows: list[Row]

    def samples(self, column: str) -> list[float]:
        """Returns the values of a column, in SI units; cells without a value are left out."""
        return [float(row[column]) for row in self.rows if row.get(column)]

    def stages(self, columns: Iterable[str]) -> Stages:
        """Returns count, median and 99th percentile of each column that has values."""
        samples = {column: self.samples(column) for column in columns}
        return {column: spread(values) for column, values in samples.items() if values}


def need_peernet() -> None:
    """Raises a failure if the program `peernet` is not built."""
    if not PEERNET.exists():
        raise Failure(f"{PEERNET} does not exist; build it with cargo build --release --package peernetd")


def run_experiment(
    folder: Path, name: str, text: str, *, timeout_s: float = 600.0, program: Path = PEERNET
) -> list[Run]:
    """Executes an experiment in a folder and returns its runs. Raises a failure if an iteration fails.

    `text` is the configuration without `[agent]` and without the keys `name` and `plots` of `[experiment]`. `program`
    is the build of `peernet` that executes it.
    """
    file, results = folder / f"{name}.toml", folder / f"{name}-results"
    if "[experiment]\n" not in text:
        raise ValueError(f"{name}: no table [experiment]")
    text = text.replace("[experiment]\n", f'[experiment]\nname = "{name}"\nplots = false\n', 1)
    file.write_text(f'{text}\n[agent]\nname = "{name}"\nstate_dir = "{folder}/{name}-state"\n')
    command = [program, "run", "--yes", "--quiet", "--restart", "--result-loc", results, file]
    output(command, folder=folder, timeout_s=timeout_s, environment={"ORT_DYLIB_PATH": str(ONNX_RUNTIME)})
    runs = [_read(path) for path in sorted(results.glob("runs/**/data.csv"))]
    if not runs or not all(run.rows for run in runs):
        raise Failure(f"{command} succeeded, but not every run below {results} has iterations after its warm-up")
    return runs


@contextmanager
def cloud(
    folder: Path, port: int, models: str, *, program: Path = PEERNETD, environment: dict[str, str] | None = None
) -> Iterator[Program]:
    """Runs an agent that offers the models of these `[[model]]` tables on a port of the loopback interface."""
    file = folder / f"cloud-{port}.toml"
    file.write_text(
        f'[agent]\nname = "cloud-{port}"\nstate_dir = "{folder}/cloud-{port}-state"\n'
        f'[serve]\nlisten = "tcp://127.0.0.1:{port}"\n{models}'
    )
    environment = {"ORT_DYLIB_PATH": str(ONNX_RUNTIME), **(environment or {})}
    with Program([program, "run", file], folder / f"cloud-{port}.log", folder=folder, environment=environment) as agent:
        agent.wait_until("it listens", lambda: _listens(agent, port))
        yield agent


def read_answers(file: Path) -> dict[str, Any]:
    """Returns the JSON answers that the actuator RECORDER wrote to a file, by the name of the sample's file."""
    lines = (line.partition(" ") for line in file.read_text().splitlines())
    return {Path(source).name: json.loads(answer) for source, _, answer in lines}


def _listens(program: Program, port: int) -> bool:
    # A program that has ended never listens.
    program.raise_if_ended()
    return sees(program, port, LISTENING)


def _read(data: Path) -> Run:
    experiment = json.loads((data.parent / "run.json").read_text())["experiment"]
    with data.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["warm-up"] == "0"]
    if failed := [row for row in rows if row["outcome"] != "ok"]:
        raise Failure(f"{len(failed)} iterations of {data.parent} failed, the first with: {failed[0]['reason']}")
    return Run(dict(experiment["configuration"]), experiment["repeat"], rows)
