#!/usr/bin/env python3
"""The work of preprocess.rs with Pillow, numpy and, where installed, Python's onnxruntime.

    preprocess.py MODEL_FOLDER PICTURE [ROUNDS]

Cards with one of the resizes `exact` and `letterbox`; the boxes of a detector of layout `yolov8` are read and suppressed with numpy.
"""

import io
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
from PIL import Image


def resized(image, resize):
    return np.asarray(image.resize((resize["width"], resize["height"]), Image.BILINEAR))


def letterboxed(image, resize):
    wide, high = resize["width"], resize["height"]
    factor = min(wide / image.width, high / image.height)
    width, height = round(image.width * factor), round(image.height * factor)
    canvas = np.full((high, wide, 3), resize.get("fill", 114), np.uint8)
    x, y = (wide - width) // 2, (high - height) // 2
    canvas[y : y + height, x : x + width] = np.asarray(image.resize((width, height), Image.BILINEAR))
    return canvas


def boxes(rows, output):
    """Boxes, classes and scores of an output [4 + classes, n]; overlapping boxes of one class are suppressed."""
    kinds, scores = rows[4:].argmax(axis=0), rows[4:].max(axis=0)
    chosen = np.flatnonzero(scores > output.get("score_threshold", 0.25))
    chosen = chosen[np.argsort(-scores[chosen], kind="stable")]
    centres, halves = rows[:2, chosen].T, rows[2:4, chosen].T / 2
    edges, kinds, scores = np.concatenate([centres - halves, centres + halves], axis=1), kinds[chosen], scores[chosen]
    areas = np.prod(edges[:, 2:] - edges[:, :2], axis=1)
    kept, left = [], np.arange(len(chosen))
    while len(left) and len(kept) < output.get("max_detections", 100):
        best, left = left[0], left[1:]
        kept.append(best)
        sides = np.minimum(edges[left, 2:], edges[best, 2:]) - np.maximum(edges[left, :2], edges[best, :2])
        common = np.prod(np.clip(sides, 0, None), axis=1)
        overlaps = common / (areas[left] + areas[best] - common)
        left = left[(kinds[left] != kinds[best]) | (overlaps <= output.get("iou_threshold", 0.45))]
    return edges[kept], kinds[kept], scores[kept]


def main():
    root = Path(__file__).resolve().parents[3] / "models/quality-control"
    arguments = dict(enumerate(sys.argv[1:]))
    folder = Path(arguments.get(0, root))
    file = Path(arguments.get(1, root / "pictures/part-0001.jpg")).read_bytes()
    rounds = int(arguments.get(2, 200))
    card = tomllib.loads((folder / "model.toml").read_text())
    steps, resize = card["preprocessing"], card["preprocessing"]["resize"]
    scale, mean, std = (np.float32(steps[key]) for key in ("scale", "mean", "std"))

    def preprocess():
        image = Image.open(io.BytesIO(file)).convert("RGB")
        pixels = letterboxed(image, resize) if resize["mode"] == "letterbox" else resized(image, resize)
        values = (pixels.astype(np.float32) * scale - mean) / std
        return np.ascontiguousarray(values.transpose(2, 0, 1)[None])

    try:
        import onnxruntime
    except ImportError:
        print("onnxruntime is not installed: inference is not measured")
        infer = None
    else:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        model = str(folder / "model.onnx")
        session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        name = card["input"]["name"]

        def infer(values):
            return session.run(None, {name: values})

    output = card["output"]
    is_detector = card["task"] == "detection" and output["layout"] == "yolov8"

    # One after the other, as an agent does, so that both programs' caches are as warm.
    durations = {"preprocessing": [], "inference": [], "postprocessing": []}
    for _ in range(rounds + 1):
        begin = time.perf_counter()
        values = preprocess()
        middle = time.perf_counter()
        durations["preprocessing"].append(middle - begin)
        if infer:
            outputs = infer(values)
            end = time.perf_counter()
            durations["inference"].append(end - middle)
            if is_detector:
                boxes(outputs[0][0], output)
                durations["postprocessing"].append(time.perf_counter() - end)
    print(f"{'':<16}{'min':>10}{'median':>10}   ms, {rounds} rounds")
    for stage, times in durations.items():
        if times:
            times = sorted(times[1:])
            print(f"{stage:<16}{times[0] * 1e3:>10.3f}{times[len(times) // 2] * 1e3:>10.3f}")


if __name__ == "__main__":
    main()
