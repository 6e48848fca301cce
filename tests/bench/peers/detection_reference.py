"""A detector written in Python in the usual way: PIL, numpy and onnxruntime with one thread. Prints JSON, in seconds.

It does what the card of a model with the layout `yolov8` says: decode, letterbox, normalise, run, decode the boxes,
suppress overlapping boxes, write the answer. The key `answers` has the objects that it found in each picture.

Usage: detection_reference.py MODEL-FOLDER PICTURES-FOLDER SECONDS
"""

from __future__ import annotations

import io
import itertools
import json
import sys
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from PIL import Image

from quantiles import spread

WARM_UP = 30
STAGES = ("preprocessing", "inference", "postprocessing", "total")


@dataclass(frozen=True)
class Letterbox:
    """How a picture was fitted into the model's input: scale of each axis, and left and upper margin in pixels."""

    # Size of the picture, pixels.
    width: int
    height: int
    scale_x: float
    scale_y: float
    left: int
    top: int


class Detector:
    """A session of onnxruntime, and the settings of the model's card."""

    def __init__(self, folder: Path) -> None:
        card: dict[str, Any] = tomllib.loads((folder / "model.toml").read_text())
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(folder / "model.onnx", options, providers=["CPUExecutionProvider"])
        preprocessing, out = card["preprocessing"], card["output"]
        self.input = card["input"]["name"]
        self.output = out["name"]
        self.width, self.height = preprocessing["resize"]["width"], preprocessing["resize"]["height"]
        self.fill = preprocessing["resize"].get("fill", 114)
        self.scale = np.float32(preprocessing["scale"])
        self.mean, self.std = np.float32(preprocessing["mean"]), np.float32(preprocessing["std"])
        self.labels: list[str] = out["labels"]
        self.score_threshold = out.get("score_threshold", 0.25)
        self.iou_threshold = out.get("iou_threshold", 0.45)
        self.max_detections = out.get("max_detections", 100)

    def prepare(self, data: bytes) -> tuple[np.ndarray, Letterbox]:
        """Decodes a picture and returns the model's input, float32 [1, 3, height, width]."""
        image = Image.open(io.BytesIO(data)).convert("RGB")
        ratio = min(self.width / image.width, self.height / image.height)
        width, height = round(image.width * ratio), round(image.height * ratio)
        left, top = (self.width - width) // 2, (self.height - height) // 2
        canvas = np.full((self.height, self.width, 3), self.fill, np.uint8)
        canvas[top : top + height, left : left + width] = np.asarray(image.resize((width, height), Image.BILINEAR))
        values = (canvas.astype(np.float32) * self.scale - self.mean) / self.std
        tensor = np.ascontiguousarray(values.transpose(2, 0, 1)[None])
        return tensor, Letterbox(image.width, image.height, width / image.width, height / image.height, left, top)

    def run(self, tensor: np.ndarray) -> np.ndarray:
        """Returns the output of the graph, [1, 4 + classes, candidates]."""
        return self.session.run([self.output], {self.input: tensor})[0]

    def answer(self, out: np.ndarray, letterbox: Letterbox) -> str:
        """Returns the objects in an output as JSON, the best first."""
        candidates = out[0].T
        scores = candidates[:, 4:]
        classes = scores.argmax(axis=1)
        best = scores[np.arange(len(scores)), classes]
        chosen = best > self.score_threshold
        candidates, classes, best = candidates[chosen], classes[chosen], best[chosen]
        boxes = np.empty((len(candidates), 4), np.float32)
        boxes[:, :2] = candidates[:, :2] - candidates[:, 2:4] / 2
        boxes[:, 2:] = candidates[:, :2] + candidates[:, 2:4] / 2
        # Boxes of different classes are moved apart, so that one pass suppresses only boxes of the same class.
        apart = boxes + (classes * np.float32(2 * max(self.width, self.height)))[:, None]
        kept = suppress(apart, best, self.iou_threshold)[: self.max_detections]
        boxes, classes, best = boxes[kept], classes[kept], best[kept]
        boxes = (boxes - [letterbox.left, letterbox.top] * 2) / ([letterbox.scale_x, letterbox.scale_y] * 2)
        boxes[:, [0, 2]] = boxes[:, [0, 2]].clip(0, letterbox.width)
        boxes[:, [1, 3]] = boxes[:, [1, 3]].clip(0, letterbox.height)
        objects = [
            {"label": self.labels[number], "score": score, "box": box}
            for number, score, box in zip(classes.tolist(), best.tolist(), boxes.tolist(), strict=True)
        ]
        return json.dumps({"detections": objects, "width": letterbox.width, "height": letterbox.height})


def suppress(boxes: np.ndarray, scores: np.ndarray, threshold: float) -> list[int]:
    """Non-maximum suppression: returns the indices of the boxes [n, 4] that remain, the best first."""
    left, top, right, bottom = boxes.T
    areas = (right - left) * (bottom - top)
    order = scores.argsort()[::-1]
    kept = []
    while order.size:
        first, others = order[0], order[1:]
        kept.append(int(first))
        width = np.minimum(right[first], right[others]) - np.maximum(left[first], left[others])
        height = np.minimum(bottom[first], bottom[others]) - np.maximum(top[first], top[others])
        shared = width.clip(0) * height.clip(0)
        order = others[shared / (areas[first] + areas[others] - shared) <= threshold]
    return kept


def main() -> None:
    detector, pictures, seconds = Detector(Path(sys.argv[1])), Path(sys.argv[2]), float(sys.argv[3])
    files = sorted(path for path in pictures.iterdir() if path.suffix in (".jpg", ".jpeg"))
    answers = {path.name: json.loads(detector.answer(*_prepare_and_run(detector, path.read_bytes()))) for path in files}
    times: dict[str, list[float]] = {stage: [] for stage in STAGES}
    end = None
    for count, path in enumerate(itertools.cycle(files)):
        if count == WARM_UP:
            end = time.perf_counter() + seconds
        data = path.read_bytes()
        stamps = [time.perf_counter()]
        tensor, letterbox = detector.prepare(data)
        stamps.append(time.perf_counter())
        out = detector.run(tensor)
        stamps.append(time.perf_counter())
        detector.answer(out, letterbox)
        stamps.append(time.perf_counter())
        if end is not None:
            spans = [*(b - a for a, b in itertools.pairwise(stamps)), stamps[-1] - stamps[0]]
            for stage, span in zip(STAGES, spans, strict=True):
                times[stage].append(span)
            if stamps[-1] > end:
                break
    figures = {stage: spread(values) for stage, values in times.items()}
    print(json.dumps({"version": onnxruntime.__version__, "stages": figures, "answers": answers}))


def _prepare_and_run(detector: Detector, data: bytes) -> tuple[np.ndarray, Letterbox]:
    tensor, letterbox = detector.prepare(data)
    return detector.run(tensor), letterbox


if __name__ == "__main__":
    main()
