"""EfficientNetV2-S from file to answer on the CPU: PEERNet, and Python with torchvision's preprocessing."""

from __future__ import annotations

import json
import os
import sys
import sysconfig
from pathlib import Path
from typing import Any

from deployment import Deployment, deployment
from experiments import RECORDER, Stages, need_peernet, read_answers, run_experiment
from programs import ROOT, Failure, output
from quantiles import median_spread
from report import Section, Table, ratio, times

NAME = "efficientnet_v2_s"
PICTURES = ROOT / "models/quality-control/pictures"
EXPORT = ROOT / "models/export_torchvision.py"
# Debian's packages of torch and torchvision are for Debian's Python only.
PYTHON = Path("/usr/bin/python3")
PACKAGES = "python3-torch python3-torchvision python3-onnx"
# Stages that PEERNet and Python measure. Python's `decode` and `transforms` are the parts of its `preprocessing`.
COMPARED = ("preprocessing", "inference", "postprocessing", "total")
THREADS = sorted({1, os.cpu_count() or 1})
WARM_UP = 3

# Largest relative difference of a score. PEERNet and Python round differently when they decode and resize, which
# changes scores of random weights by up to 1 %.
SCORE_TOLERANCE = 0.05
# Largest aimed-for ratio of PEERNet's total to Python's.
TOTAL_AIM = 1.0


def prepare() -> None:
    need_peernet()
    script = "import sys, torch, torchvision, onnx; print('%d.%d' % sys.version_info[:2])"
    try:
        version = output([PYTHON, "-c", script]).strip()
    except (Failure, OSError) as error:
        raise Failure(
            f"{PYTHON} cannot import torch, torchvision and onnx; install them with apt-get install {PACKAGES} "
            f"(deploy/install-tools.sh test does): {error}"
        ) from None
    own = f"{sys.version_info.major}.{sys.version_info.minor}"
    if version != own:
        raise Failure(
            f"{PYTHON} is Python {version}, but the onnxruntime of the benchmarks is for Python {own}; create "
            f".venv-tools with {PYTHON} -m venv"
        )


def measure(quick: bool) -> Section:
    repeats, seconds = (1, 3) if quick else (5, 6)
    with deployment() as daemons:
        print(f"  exporting {NAME}", file=sys.stderr, flush=True)
        export = [PYTHON, "-B", EXPORT, NAME, "--weights", "none", "--models-dir", daemons.folder]
        output(export, timeout_s=600)
        _check(daemons)
        ours: dict[int, list[Stages]] = {threads: [] for threads in THREADS}
        theirs: dict[int, list[Stages]] = {threads: [] for threads in THREADS}
        versions: dict[str, str] = {}
        for repeat in range(repeats):
            for threads in THREADS:
                # The order alternates from repeat to repeat.
                for turn in ("peernet", "python")[:: 1 if repeat % 2 == 0 else -1]:
                    if turn == "peernet":
                        ours[threads].append(_peernet(daemons, threads, seconds))
                    else:
                        figures = _python(daemons, threads, seconds)
                        versions = figures["versions"]
                        theirs[threads].append(figures["stages"])
            print(f"  repeat {repeat + 1} of {repeats}", file=sys.stderr, flush=True)
    section = Section("EfficientNetV2-S")
    section.say(
        "From JPEG files of 1280 × 960 pixels to the five best classes, on the CPU, random weights. PEERNet: `peernet "
        "run` with a local pipeline in a closed loop. Python: PIL, the transforms of torchvision "
        f"{versions['torchvision']} (torch {versions['torch']}, pillow {versions['pillow']}), onnxruntime, numpy. ONNX "
        f"Runtime {versions['onnxruntime']} and the same number of threads on both sides. {repeats} repeats of "
        f"{seconds} s each, in turn; medians over the repeats, ratios taken repeat by repeat. Both give the same best "
        "class of each picture."
    )
    for threads in THREADS:
        _table(section, threads, ours[threads], theirs[threads])
    return section


def _table(section: Section, threads: int, ours: list[Stages], theirs: list[Stages]) -> None:
    what = f"{threads} thread{'' if threads == 1 else 's'}"
    table = Table(f"{what}, ms", "PEERNet p50", "p99", "Python p50", "p99", "PEERNet to Python")
    for stage in ("decode", "transforms", *COMPARED):
        cells = []
        for side in (ours, theirs):
            spreads = [one[stage] for one in side if stage in one]
            figures = median_spread(spreads) if spreads else {}
            cells += [f"{figures[key] * 1e3:.2f}" if figures else "–" for key in ("p50", "p99")]
        table.row(stage, *cells, times(_ratio(ours, theirs, stage)) if stage in COMPARED else "–")
    section.table(table)
    cost = _ratio(ours, theirs, "total")
    promise = f"EfficientNetV2-S from file to answer, {what}: ≤ {TOTAL_AIM:g} × Python with torchvision"
    section.aim(promise, times(cost), cost <= TOTAL_AIM)


def _ratio(ours: list[Stages], theirs: list[Stages], stage: str) -> float:
    return ratio([one[stage]["p50"] for one in ours], [one[stage]["p50"] for one in theirs])


def _peernet(daemons: Deployment, threads: int, seconds: int) -> Stages:
    limit = f"duration_s = {seconds}.0\nwarm_up = {{ iterations = {WARM_UP} }}"
    (run,) = run_experiment(daemons.folder, NAME, _experiment(daemons, threads, limit, ""))
    return run.stages(COMPARED)


def _experiment(daemons: Deployment, threads: int, limit: str, actuator: str) -> str:
    return f"""
[experiment]
{limit}
[[model]]
name = "{NAME}"
kind = "onnx"
path = "{daemons.folder}/{NAME}"
intra_threads = {threads}
inter_threads = 1
[pipeline]
sensor = {{ kind = "images", path = "{PICTURES}" }}
placement = {{ kind = "local", model = "{NAME}" }}
load = {{ mode = "closed" }}
{actuator}
"""


def _python(daemons: Deployment, threads: int, seconds: float) -> dict[str, Any]:
    reference = ["-m", "peers.torchvision_reference", daemons.folder / NAME, PICTURES, seconds, threads]
    command = [PYTHON, "-B", *reference, sysconfig.get_path("purelib")]
    figures: dict[str, Any] = json.loads(output(command, timeout_s=seconds + 120))
    return figures


def _check(daemons: Deployment) -> None:
    """Raises a failure unless PEERNet and Python give the same best class with nearly the same score."""
    theirs = _python(daemons, 1, 1)["answers"]
    answers = daemons.folder / "answers.txt"
    actuator = f'actuator = {{ kind = "exec", command = ["{RECORDER}", "{answers}"] }}'
    # Python reports an answer for each picture that it had time for. Both begin with the first picture by name.
    text = _experiment(daemons, 1, f"iterations = {len(theirs)}\nwarm_up = {{ iterations = 0 }}", actuator)
    run_experiment(daemons.folder, "check", text)
    ours = read_answers(answers)
    for name, their in theirs.items():
        our = ours.get(name)
        if our is None or our["label"] != their["label"]:
            raise Failure(f"{name}: PEERNet answers {our}, Python with torchvision {their}")
        if abs(our["score"] - their["score"]) > SCORE_TOLERANCE * their["score"]:
            raise Failure(
                f"{name}: PEERNet's score is {our['score']}, that of Python with torchvision {their['score']}"
            )
