#!/usr/bin/env python3
"""Does the work of preprocess.rs with Pillow, numpy and, if it is installed, Python's onnxruntime.

    preprocess.py MODEL_FOLDER PICTURE [ROUNDS]

The resize mode in the model's card (`model.toml`) must be `exact` or `letterbox`. For a detector of layout `yolov8`,
numpy selects the boxes and suppresses overlapping ones. For other models, no postprocessing is measured.
"""

import io
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
from PIL import Image


def resize_exact(image, resize):
    return np.asarray(image.resize((resize["width"], resize["height"]), Image.BILINEAR))


def resize_letterbox(image, resize):
    canvas_width, canvas_height = resize["width"], resize["height"]
    factor = min(canvas_width / image.width, canvas_height / image.height)
    width, height = round(image.width * factor), round(image.height * factor)
    canvas = np.full((canvas_height, canvas_width, 3), resize.get("fill", 114), np.uint8)
    x, y = (canvas_width - width) // 2, (canvas_height - height) // 2
    canvas[y : y + height, x : x + width] = np.asarray(image.resize((width, height), Image.BILINEAR))
    return canvas


def select_boxes(rows, output):
    """Returns boxes, classes and scores, without overlapping boxes of one class.

    `rows` is the model's output [4 + classes, n]; `output` is the table of the card with the thresholds.
    """
    classes, scores = rows[4:].argmax(axis=0), rows[4:].max(axis=0)
    candidates = np.flatnonzero(scores > output.get("score_threshold", 0.25))
    candidates = candidates[np.argsort(-scores[candidates], kind="stable")]
    centres, halves = rows[:2, candidates].T, rows[2:4, candidates].T / 2
    edges = np.concatenate([centres - halves, centres + halves], axis=1)
    classes, scores = classes[candidates], scores[candidates]
    areas = np.prod(edges[:, 2:] - edges[:, :2], axis=1)
    kept, remaining = [], np.arange(len(candidates))
    while len(remaining) and len(kept) < output.get("max_detections", 100):
        best, remaining = remaining[0], remaining[1:]
        kept.append(best)
        common_sides = np.minimum(edges[remaining, 2:], edges[best, 2:]) - np.maximum(edges[remaining, :2], edges[best, :2])
        common_areas = np.prod(np.clip(common_sides, 0, None), axis=1)
        overlaps = common_areas / (areas[remaining] + areas[best] - common_areas)
        remaining = remaining[(classes[remaining] != classes[best]) | (overlaps <= output.get("iou_threshold", 0.45))]
    return edges[kept], classes[kept], scores[kept]


def main():
    demo = Path(__file__).resolve().parents[3] / "models/quality-control"
    arguments = dict(enumerate(sys.argv[1:]))
    folder = Path(arguments.get(0, demo))
    file = Path(arguments.get(1, demo / "pictures/part-0001.jpg")).read_bytes()
    rounds = int(arguments.get(2, 200))
    card = tomllib.loads((folder / "model.toml").read_text())
    steps, resize = card["preprocessing"], card["preprocessing"]["resize"]
    scale, mean, std = (np.float32(steps[key]) for key in ("scale", "mean", "std"))

    def preprocess():
        image = Image.open(io.BytesIO(file)).convert("RGB")
        pixels = resize_letterbox(image, resize) if resize["mode"] == "letterbox" else resize_exact(image, resize)
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

    # The stages of a picture run one after the other, as in an agent, so that the processor's caches are equally warm in
    # both programs.
    durations = {"preprocessing": [], "inference": [], "postprocessing": []}
    # The first round is a warm-up, which the table leaves out.
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
                select_boxes(outputs[0][0], output)
                durations["postprocessing"].append(time.perf_counter() - end)
    print(f"{'':<16}{'min':>10}{'median':>10}   ms, {rounds} rounds")
    for stage, times in durations.items():
        if times:
            times = sorted(times[1:])
            print(f"{stage:<16}{times[0] * 1e3:>10.3f}{times[len(times) // 2] * 1e3:>10.3f}")


if __name__ == "__main__":
    main()
