"""Detectors in PEERNet and in Python, with the same library, one thread and the same pictures."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import graphs
from deployment import Deployment, deployment
from experiments import RECORDER, Stages, need_peernet, read_answers, run_experiment
from programs import ROOT, Failure, output, peer
from quantiles import median_spread
from report import Section, Table, micros, ratio, times

MODELS = ROOT / "models"
STAGES = ("preprocessing", "inference", "postprocessing", "total")
WARM_UP = 30

# Largest aimed-for ratio of PEERNet's time to Python's.
AIM = 1.0

# Objects in each picture, by the picture's file name.
Answers = dict[str, list[dict[str, Any]]]


@dataclass
class Case:
    """A model with its pictures, and the stages of each repeat."""

    title: str
    model: Path
    pictures: Path
    score_threshold: float
    # Largest accepted differences of the edges of a box, pixels of the picture, and of a score.
    edge_tolerance: float
    score_tolerance: float
    ours: list[Stages] = field(default_factory=list)
    theirs: list[Stages] = field(default_factory=list)
    # Number of objects that both PEERNet and Python found, over all pictures; largest differences of the edges (pixels)
    # and scores of the same object.
    objects: int = 0
    edge_difference: float = 0.0
    score_difference: float = 0.0

    def time_ratio(self, stage: str) -> float:
        return ratio([one[stage]["p50"] for one in self.ours], [one[stage]["p50"] for one in self.theirs])


def prepare() -> None:
    need_peernet()
    if not (MODELS / "defect-detector/model.onnx").exists():
        raise Failure(f"{MODELS}/defect-detector/model.onnx does not exist: it belongs to the checkout")


def measure(quick: bool) -> Section:
    repeats, seconds = (2, 2) if quick else (7, 4)
    with deployment() as daemons:
        large = daemons.folder / "yolov8-shape"
        graphs.make_detector(large)
        defects = MODELS / "defect-detector"
        cases = [
            # The two JPEG decoders round differently: about one byte in seven differs by 1. This changes scores of
            # this small model by up to 0.07.
            Case("defect-detector", defects, defects / "pictures", 0.3, 4.0, 0.1),
            # The output does not depend on the pictures, so only the rounding of boxes differs.
            Case("shape of YOLOv8", large, MODELS / "quality-control/pictures", 0.25, 0.01, 1e-5),
        ]
        for number, case in enumerate(cases):
            _check(daemons, case, number)
        version = ""
        for repeat in range(repeats):
            for case in cases:
                # The order alternates from repeat to repeat.
                for turn in ("peernet", "python")[:: 1 if repeat % 2 == 0 else -1]:
                    if turn == "peernet":
                        case.ours.append(_peernet(daemons, case, seconds))
                    else:
                        figures = _python(case, seconds)
                        version = figures["version"]
                        case.theirs.append(figures["stages"])
            print(f"  repeat {repeat + 1} of {repeats}", file=sys.stderr, flush=True)
    return _section(cases, version, repeats, seconds)


def _section(cases: list[Case], version: str, repeats: int, seconds: int) -> Section:
    section = Section("Detection")
    section.say(
        f"Two detectors on JPEG files, ONNX Runtime {version} from the same wheel on both sides, one thread; "
        f"`peernet run` with a local pipeline in a closed loop. {repeats} repeats of {seconds} s each, in turn; "
        "medians over the repeats, ratios taken repeat by repeat. Python: PIL, numpy with vectorised non-maximum "
        "suppression, and JSON. `preprocessing` decodes the file, fits it into a letterbox and normalises it; "
        "`postprocessing` decodes the boxes, suppresses overlapping ones and writes the answer.\n\n"
        "- *defect-detector*: pictures of 640 × 480 pixels, input 224 × 168, 588 candidates of 3 classes.\n"
        f"- *shape of YOLOv8*: pictures of 1280 × 960 pixels, input 640 × 640, {graphs.CANDIDATES:,} candidates of "
        f"{graphs.CLASSES} classes, {graphs.CONFIDENT:.0%} of them above the threshold; its output is constant, so "
        "the time of its inference has no meaning."
    )
    for case in cases:
        table = Table(f"{case.title}, µs", "PEERNet p50", "p99", "Python p50", "p99", "PEERNet to Python")
        for stage in STAGES:
            ours, theirs = (median_spread([one[stage] for one in side]) for side in (case.ours, case.theirs))
            cells = [micros(spread[key]) for spread in (ours, theirs) for key in ("p50", "p99")]
            table.row(stage, *cells, times(case.time_ratio(stage)))
        section.table(table)
        section.say(
            f"PEERNet and Python found the same {case.objects} objects: edges differ by at most "
            f"{case.edge_difference:.2f} pixels, scores by at most {case.score_difference:.4f}."
        )
        for stage in ("preprocessing", "postprocessing"):
            cost = case.time_ratio(stage)
            promise = f"detection, {case.title}: `{stage}` ≤ {AIM:g} × Python's"
            section.aim(promise, times(cost), cost <= AIM)
    return section


def _peernet(daemons: Deployment, case: Case, seconds: int) -> Stages:
    text = _experiment(case, f"duration_s = {seconds}.0\nwarm_up = {{ iterations = {WARM_UP} }}", "")
    (run,) = run_experiment(daemons.folder, case.model.name, text, timeout_s=seconds + 120)
    return run.stages(STAGES)


def _experiment(case: Case, limit: str, actuator: str) -> str:
    return f"""
[experiment]
{limit}
[[model]]
name = "detector"
kind = "onnx"
path = "{case.model}"
intra_threads = 1
inter_threads = 1
[pipeline]
sensor = {{ kind = "images", path = "{case.pictures}" }}
placement = {{ kind = "local", model = "detector" }}
load = {{ mode = "closed" }}
{actuator}
"""


def _python(case: Case, seconds: float) -> dict[str, Any]:
    command = peer("detection_reference", case.model, case.pictures, seconds)
    figures: dict[str, Any] = json.loads(output(command, timeout_s=seconds + 120))
    return figures


def _check(daemons: Deployment, case: Case, number: int) -> None:
    """Raises a failure unless PEERNet and Python find the same objects in each picture."""
    answers = daemons.folder / f"answers-{number}.txt"
    count = len([path for path in case.pictures.iterdir() if path.suffix in (".jpg", ".jpeg")])
    actuator = f'actuator = {{ kind = "exec", command = ["{RECORDER}", "{answers}"] }}'
    text = _experiment(case, f"iterations = {count}\nwarm_up = {{ iterations = 0 }}", actuator)
    run_experiment(daemons.folder, f"check-{number}", text)
    ours: Answers = {name: one["detections"] for name, one in read_answers(answers).items()}
    theirs: Answers = {name: one["detections"] for name, one in _python(case, 0.1)["answers"].items()}
    if ours.keys() != theirs.keys():
        raise Failure(f"{case.title}: PEERNet answered {sorted(ours)}, Python {sorted(theirs)}")
    for name in theirs:
        _compare(case, name, ours[name], theirs[name])
    if case.objects == 0:
        raise Failure(f"{case.title}: neither PEERNet nor Python found an object, so nothing was compared")


def _compare(case: Case, name: str, ours: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> None:
    left = list(theirs)
    unmatched = []
    for found in ours:
        near = [
            one
            for one in left
            if one["label"] == found["label"] and _edge_difference(one, found) <= case.edge_tolerance
        ]
        if not near:
            unmatched.append(found)
            continue
        match = min(near, key=lambda one: _edge_difference(one, found))
        left.remove(match)
        case.objects += 1
        case.edge_difference = max(case.edge_difference, _edge_difference(match, found))
        case.score_difference = max(case.score_difference, abs(match["score"] - found["score"]))
    # An object whose score is near the threshold may be missing in one of the answers.
    missing = [one for one in unmatched + left if one["score"] > case.score_threshold + case.score_tolerance]
    if missing or case.score_difference > case.score_tolerance:
        raise Failure(
            f"{case.title}, {name}: PEERNet and Python found different objects (scores differ by up to "
            f"{case.score_difference:.4f}):\n    PEERNet {json.dumps(ours)}\n    Python  {json.dumps(theirs)}"
        )


def _edge_difference(one: dict[str, Any], other: dict[str, Any]) -> float:
    """Returns the largest difference between the edges of two boxes, pixels."""
    return max(abs(a - b) for a, b in zip(one["box"], other["box"], strict=True))
