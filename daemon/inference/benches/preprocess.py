#!/usr/bin/env python3
"""The work of preprocess.rs with Pillow, numpy and, where installed, Python's onnxruntime.

    preprocess.py MODEL_FOLDER PICTURE [ROUNDS]
"""

import io
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
from PIL import Image


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
        image = image.resize((resize["width"], resize["height"]), Image.BILINEAR)
        values = (np.asarray(image).astype(np.float32) * scale - mean) / std
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

    # One after the other, as an agent does, so that both programs' caches are as warm.
    taken = {"preprocessing": [], "inference": []}
    for _ in range(rounds + 1):
        begin = time.perf_counter()
        values = preprocess()
        middle = time.perf_counter()
        taken["preprocessing"].append(middle - begin)
        if infer:
            infer(values)
            taken["inference"].append(time.perf_counter() - middle)
    print(f"{'':<16}{'min':>10}{'median':>10}   ms, {rounds} rounds")
    for stage, times in taken.items():
        if times:
            times = sorted(times[1:])
            print(f"{stage:<16}{times[0] * 1e3:>10.3f}{times[len(times) // 2] * 1e3:>10.3f}")


if __name__ == "__main__":
    main()
