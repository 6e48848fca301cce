"""The demo model through the agent and through Python: the same library, one thread, the same pictures."""

from __future__ import annotations

import json

import store
from deployment import free_ports, deployment
from programs import ROOT, Failure, output, peer
from quantiles import median_spread
from report import Section, Table, micros, ratio, times

MODEL = ROOT / "models/quality-control"
PICTURES = MODEL / "pictures"
COMPARED = ("preprocessing", "inference")
STAGES = ("sensing", "queue", *COMPARED, "postprocessing", "total", "unattributed")

INFERENCE_AIM = 1.02
PREPROCESSING_AIM = 3.0

Stages = dict[str, dict[str, float]]


def prepare() -> None:
    if not (MODEL / "model.onnx").exists():
        raise Failure(f"{MODEL}/model.onnx does not exist: it belongs to the checkout")


def measure(quick: bool) -> Section:
    repeats, seconds = (2, 2) if quick else (9, 4)
    ours: list[Stages] = []
    theirs: list[Stages] = []
    version = ""
    for repeat in range(repeats):
        # The order alternates from repeat to repeat.
        for turn in ("agent", "python")[:: 1 if repeat % 2 == 0 else -1]:
            if turn == "agent":
                ours.append(_agent(seconds))
            else:
                figures = json.loads(output(peer("onnx_reference", MODEL, PICTURES, seconds), timeout_s=seconds + 60))
                version = figures["version"]
                theirs.append(figures["stages"])
    section = Section("The model")
    section.say(
        f"The demo model on its own pictures (JPEG, 1280×960), ONNX Runtime {version} from the same wheel on both "
        f"sides, one thread; a local pipeline in a closed loop, its iterations stored. {repeats} repeats of "
        f"{seconds} s each, in turn; medians over the repeats, ratios taken repeat by repeat. Python: PIL and numpy as "
        "in training, then `session.run`."
    )
    table = Table("µs", "agent p50", "p99", "Python p50", "p99", "agent to Python")
    for stage in STAGES:
        cells = []
        for side in (ours, theirs):
            spreads = [one[stage] for one in side if stage in one]
            spread = median_spread(spreads) if spreads else {}
            cells += [micros(spread.get("p50")), micros(spread.get("p99"))]
        table.row(stage, *cells, times(_ratio(ours, theirs, stage)) if stage in COMPARED else "–")
    section.table(table)
    cost = _ratio(ours, theirs, "inference")
    section.aim(f"`inference` ≤ {INFERENCE_AIM:g} × Python's onnxruntime", times(cost), cost <= INFERENCE_AIM)
    gain = 1 / _ratio(ours, theirs, "preprocessing")
    promise = f"JPEG to tensor at least {PREPROCESSING_AIM:g} × faster than PIL and numpy"
    section.aim(promise, times(gain), gain >= PREPROCESSING_AIM)
    return section


def _ratio(ours: list[Stages], theirs: list[Stages], stage: str) -> float:
    return ratio([one[stage]["p50"] for one in ours], [one[stage]["p50"] for one in theirs])


def _agent(seconds: int) -> Stages:
    events, web = free_ports(2)
    with deployment() as daemons:
        daemons.aggregator(events=events, web=web)
        edge = daemons.daemon("edge", _configuration(daemons.folder, events, seconds))
        edge.wait_until("the run is stored", lambda: daemons.is_stored("local"), seconds + 60)
        daemons.stop()
        run = store.run_of(daemons.database, "local")
        if run is None or run.unsuccessful or not run.ok:
            raise Failure(f"the local pipeline did not go well: {run}; the agent said:\n{edge.text()}")
        return store.stages(daemons.database, run)


def _configuration(folder: object, events: int, seconds: int) -> str:
    return f"""
        [agent]
        name = "edge"
        state_dir = "{folder}/edge"
        aggregator = "tcp://127.0.0.1:{events}"
        [[model]]
        name = "quality-control"
        kind = "onnx"
        path = "{MODEL}"
        intra_threads = 1
        inter_threads = 1
        [[pipeline]]
        name = "local"
        sensor = {{ kind = "images", path = "{PICTURES}" }}
        placement = {{ kind = "local", model = "quality-control" }}
        load = {{ mode = "closed" }}
        warm_up = {{ iterations = 30 }}
        limit = {{ duration_s = {seconds}.0 }}
    """
