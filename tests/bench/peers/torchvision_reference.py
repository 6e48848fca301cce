"""A classifier of torchvision in Python in the usual way: its transforms, then onnxruntime. Prints JSON, in seconds.

It needs torch and torchvision, which Debian packages for the system's Python. PACKAGES is the folder of installed
packages that has onnxruntime. The key `answers` has the best classes of each picture.

Usage: torchvision_reference.py MODEL-FOLDER PICTURES-FOLDER SECONDS THREADS PACKAGES
"""

from __future__ import annotations

import io
import itertools
import json
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

# PACKAGES comes after the system's packages, so that torch gets the numpy that it was built with.
sys.path.append(sys.argv[5])

import numpy as np
import onnxruntime
import PIL
import torch
import torchvision
from PIL import Image

from quantiles import spread

WARM_UP = 3
TOP = 5
STAGES = ("decode", "transforms", "preprocessing", "inference", "postprocessing", "total")


class Classifier:
    """A session of onnxruntime, and the transforms that belong to the model's default weights."""

    def __init__(self, folder: Path, threads: int) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
        torch.set_num_threads(threads)
        self.session = onnxruntime.InferenceSession(folder / "model.onnx", options, providers=["CPUExecutionProvider"])
        self.input = self.session.get_inputs()[0].name
        self.labels: list[str] = tomllib.loads((folder / "model.toml").read_text())["output"]["labels"]
        self.transforms = _weights(folder.name).transforms()

    def answer(self, data: bytes) -> tuple[str, list[float]]:
        """Returns the answer to a picture file as JSON, and the time before the first step and after each step."""
        stamps = [time.perf_counter()]
        image = Image.open(io.BytesIO(data)).convert("RGB")
        stamps.append(time.perf_counter())
        with torch.inference_mode():
            tensor = self.transforms(image)[None].numpy()
        stamps.append(time.perf_counter())
        logits = self.session.run(None, {self.input: tensor})[0][0]
        stamps.append(time.perf_counter())
        scores = np.exp(logits - logits.max())
        scores /= scores.sum()
        top = [
            {"label": self.labels[number], "score": float(scores[number])} for number in scores.argsort()[::-1][:TOP]
        ]
        text = json.dumps({**top[0], "top": top})
        stamps.append(time.perf_counter())
        return text, stamps


def _weights(name: str) -> Any:
    """Returns the description of a model's default weights, without downloading the weights."""
    if hasattr(torchvision.models, "get_model_weights"):
        return torchvision.models.get_model_weights(name).DEFAULT
    raise SystemExit(f"torchvision {torchvision.__version__} is too old; 0.14 or newer is required")


def main() -> None:
    folder, pictures, seconds, threads = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
    classifier = Classifier(folder, threads)
    files = sorted(path for path in pictures.iterdir() if path.suffix in (".jpg", ".jpeg"))
    answers: dict[str, Any] = {}
    times: dict[str, list[float]] = {stage: [] for stage in STAGES}
    end = None
    for count, path in enumerate(itertools.cycle(files)):
        if count == WARM_UP:
            end = time.perf_counter() + seconds
        text, stamps = classifier.answer(path.read_bytes())
        answers[path.name] = json.loads(text)
        if end is not None:
            decode, transforms, inference, postprocessing = (b - a for a, b in itertools.pairwise(stamps))
            total = stamps[-1] - stamps[0]
            spans = (decode, transforms, decode + transforms, inference, postprocessing, total)
            for stage, span in zip(STAGES, spans, strict=True):
                times[stage].append(span)
            if stamps[-1] > end:
                break
    versions = {
        "onnxruntime": onnxruntime.__version__,
        "torchvision": torchvision.__version__,
        "torch": torch.__version__,
        "pillow": PIL.__version__,
    }
    figures = {stage: spread(values) for stage, values in times.items()}
    print(json.dumps({"versions": versions, "stages": figures, "answers": answers}))


if __name__ == "__main__":
    main()
