"""The model's card, model.toml. train.py writes it; check.py adds the accuracy that it measured."""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path

import preprocessing
from scene import LABELS

TEMPLATE = """\
name = "quality-control"
task = "classification"
description = "Tells good machined plates on a conveyor from scratched and dented ones and from those that lack a hole."
version = "1"

[input]
name = "image"
dtype = "float32"
layout = "nchw"
shape = [1, 3, {height}, {width}]
colour = "rgb"

[preprocessing]
resize = {{ mode = "exact", width = {width}, height = {height}, filter = "bilinear" }}
scale = {scale!r}
mean = {mean}
std = {std}

[output]
name = "logits"
activation = "softmax"
top_k = {classes}
labels = {labels}

[provenance]
script = "models/quality_control/train.py"
seed = {seed}
trained_on = "{scenes} drawn scenes (seeds {first} to {last}), each at three picture sizes, JPEG quality 70 to 95"
accuracy = {accuracy}
sha256 = "{digest}"
licence = "MIT OR Apache-2.0"
"""

UNMEASURED = "0.0"


def read(folder: Path) -> dict:
    """The card in a model's folder."""
    return tomllib.loads((folder / "model.toml").read_text())


def write(folder: Path, seed: int, first: int, scenes: int) -> None:
    """Writes the card of the model.onnx in `folder`. Its accuracy is 0.0, because it is not measured yet."""
    text = TEMPLATE.format(
        width=preprocessing.WIDTH,
        height=preprocessing.HEIGHT,
        scale=preprocessing.SCALE,
        mean=list(preprocessing.MEAN),
        std=list(preprocessing.STD),
        classes=len(LABELS),
        labels=json.dumps(list(LABELS)),
        seed=seed,
        scenes=scenes,
        first=first,
        last=first + scenes - 1,
        accuracy=UNMEASURED,
        digest=digest(folder),
    )
    (folder / "model.toml").write_text(text)


def write_accuracy(folder: Path, accuracy: float) -> None:
    """Writes the measured accuracy into the card."""
    path = folder / "model.toml"
    lines = path.read_text().splitlines()
    lines = [f"accuracy = {accuracy!r}" if line.startswith("accuracy =") else line for line in lines]
    path.write_text("\n".join(lines) + "\n")


def digest(folder: Path) -> str:
    """SHA-256 of the folder's model.onnx, hexadecimal."""
    return hashlib.sha256((folder / "model.onnx").read_bytes()).hexdigest()
