"""Trains a detector of defects on the features of the classifier, and writes model.onnx, its card and test pictures.

    detector.py models/quality-control models/defect-detector

The weights of the trained classifier's convolutions are kept. A head that takes their output is trained on drawn
scenes, whose boxes are known (boxes.py). The output has the layout of YOLOv8: centre, size and scores of the classes
for each cell of 8 x 8 pixels. Nothing is downloaded. The committed model was trained with --scenes 320 --epochs 14, in
about five minutes on two cores.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import time
from multiprocessing import Pool
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import nn

import boxes
import dataset
import draw
import scene as scenes
from network import CELL
from preprocessing import HEIGHT, MEAN, SCALE, STD, WIDTH, normalise
from scene import LABELS

SEED = 7
TRAINING_SEEDS = 7_000_000  # first seed of the scenes of the training set
PICTURE_SEEDS = 8_000_001  # first seed of the scenes of the test pictures
EPOCHS, BATCH, PEAK_RATE = 14, 32, 2e-3
INITIAL_LOGIT = -4.0  # of each cell before the training; it is low because hardly any cell is the centre of a defect
CENTRE_RADIUS_CELLS = 1.0  # the cells this close to the centre of a box, along both axes, must find the box
OPSET = 13
ROWS, COLUMNS = HEIGHT // CELL, WIDTH // CELL

CARD = """\
name = "defect-detector"
task = "detection"
description = "Finds scratches, dents and missing holes of machined plates on a conveyor."
version = "1"

[input]
name = "image"
dtype = "float32"
layout = "nchw"
shape = [1, 3, {height}, {width}]
colour = "rgb"

[preprocessing]
resize = {{ mode = "letterbox", width = {width}, height = {height}, filter = "bilinear" }}
scale = {scale!r}
mean = {mean}
std = {std}

[output]
layout = "yolov8"
name = "boxes"
score_threshold = 0.3
iou_threshold = 0.4
labels = {labels}

[provenance]
script = "models/quality_control/detector.py"
seed = {seed}
trained_on = "{scenes} drawn scenes (seeds {first} to {last}), each at three picture sizes; features of quality-control"
sha256 = "{digest}"
licence = "MIT OR Apache-2.0"
"""


class Detector(nn.Module):
    """Computes boxes and scores [n, 4 + classes, cells] from normalised pictures [n, 3, height, width]."""

    def __init__(self, classifier: Path) -> None:
        super().__init__()
        self.features = _features(classifier)
        channels = 64  # of the classifier's last features
        self.head = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=2, dilation=2),
            nn.ReLU(),
        )
        self.scores = nn.Conv2d(channels, len(boxes.NAMES), 1)
        # Distances from the middle of a cell to the left, top, right and bottom side of its box.
        self.sides = nn.Conv2d(channels, 4, 1)
        nn.init.constant_(self.scores.bias, INITIAL_LOGIT)
        rows, columns = torch.meshgrid(torch.arange(ROWS), torch.arange(COLUMNS), indexing="ij")
        self.register_buffer("centres", CELL * (torch.stack([columns, rows]).float() + 0.5))

    def raw(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits of the classes [n, classes, rows, columns], and the boxes' edges [n, 4, rows, columns] in pixels."""
        hidden = self.head(features)
        sides = CELL * nn.functional.softplus(self.sides(hidden))
        return self.scores(hidden), torch.cat([self.centres - sides[:, :2], self.centres + sides[:, 2:]], dim=1)

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """Centres, sizes and scores [n, 4 + classes, cells]: the output of the exported model."""
        logits, edges = self.raw(self.features(pictures))
        low, high = edges[:, :2], edges[:, 2:]
        return torch.cat([(low + high) / 2, high - low, logits.sigmoid()], dim=1).flatten(2)


def _features(classifier: Path) -> nn.Sequential:
    """The classifier's convolutions, from its ONNX graph, in which batch normalisation is a part of their weights."""
    graph = onnx.load(str(classifier / "model.onnx")).graph
    weights = {tensor.name: torch.from_numpy(numpy_helper.to_array(tensor).copy()) for tensor in graph.initializer}
    layers: list[nn.Module] = []
    for node in graph.node:
        # `locate`, which computes the classifier's maps from the features, is left out.
        if node.op_type != "Conv" or node.input[1] == "locate.weight":
            continue
        options = {attribute.name: list(attribute.ints) for attribute in node.attribute if attribute.ints}
        weight, bias = weights[node.input[1]], weights[node.input[2]]
        layer = nn.Conv2d(
            weight.shape[1],
            weight.shape[0],
            3,
            stride=options["strides"][0],
            padding=options["pads"][0],
            dilation=options["dilations"][0],
        )
        layer.weight.data, layer.bias.data = weight, bias
        layers += [layer, nn.ReLU()]
    return nn.Sequential(*layers).requires_grad_(False)


def cell_targets(seed: int, mirrored: bool) -> np.ndarray:
    """For each cell: class + 1 of the box that it must find (0: no box), and the box's edges: [5, rows, columns]."""
    targets = np.zeros((5, ROWS, COLUMNS), np.float32)
    drawn = boxes.boxes(scenes.sample(seed, LABELS[seed % len(LABELS)]), WIDTH)
    # Smaller boxes overwrite larger boxes in the cells of both, because they are harder to find.
    for box in sorted(drawn, key=lambda box: -(box.right - box.left) * (box.bottom - box.top)):
        left, right = (WIDTH - box.right, WIDTH - box.left) if mirrored else (box.left, box.right)
        x, y = (left + right) / 2 / CELL - 0.5, (box.top + box.bottom) / 2 / CELL - 0.5
        near_rows = np.abs(np.arange(ROWS) - y) <= CENTRE_RADIUS_CELLS
        near_columns = np.abs(np.arange(COLUMNS) - x) <= CENTRE_RADIUS_CELLS
        target = np.array([box.kind + 1, left, box.top, right, box.bottom], np.float32)
        targets[:, near_rows[:, None] & near_columns] = target[:, None]
    return targets


def draw_training_set(
    detector: Detector, first_seed: int, count: int, workers: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Features [n, 64, rows, columns] and targets [n, 5, rows, columns] of scenes: in three sizes, also mirrored."""
    seeds = range(first_seed, first_seed + count)
    features, targets = [], []
    with Pool(workers) as pool, torch.no_grad():
        for seed, pictures in zip(seeds, pool.imap(dataset.input_variants, seeds, chunksize=4)):
            for picture in pictures:
                for mirrored in (False, True):
                    shown = np.ascontiguousarray(picture[:, ::-1]) if mirrored else picture
                    features.append(detector.features(torch.from_numpy(normalise(shown)))[0].half())
                    targets.append(torch.from_numpy(cell_targets(seed, mirrored)))
    return torch.stack(features), torch.stack(targets)


def loss_of(detector: Detector, features: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """Focal loss of the classes, and 1 - IoU of the boxes in cells that must find a box."""
    logits, edges = detector.raw(features.float())
    kinds = targets[:, 0].long()
    positive = kinds > 0
    count = positive.sum().clamp(min=1)
    expected = nn.functional.one_hot(kinds, len(boxes.NAMES) + 1)[..., 1:].permute(0, 3, 1, 2).float()
    probability = logits.sigmoid()
    wrong = torch.where(expected > 0, 1 - probability, probability)
    weight = torch.where(expected > 0, 0.25, 0.75) * wrong**2
    entropy = nn.functional.binary_cross_entropy_with_logits(logits, expected, reduction="none")
    class_loss = (weight * entropy).sum() / count
    edges, true_edges = (values.permute(0, 2, 3, 1)[positive] for values in (edges, targets[:, 1:]))
    return 2 * class_loss + (1 - overlap(edges, true_edges)).sum() / count


def overlap(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """For each pair of boxes [n, 4], the ratio of their intersection to their union (IoU)."""
    common = (torch.minimum(a[:, 2:], b[:, 2:]) - torch.maximum(a[:, :2], b[:, :2])).clamp(min=0).prod(1)
    area = (a[:, 2:] - a[:, :2]).prod(1) + (b[:, 2:] - b[:, :2]).prod(1)
    return common / (area - common).clamp(min=1e-6)


def train(detector: Detector, training: tuple[torch.Tensor, torch.Tensor], epochs: int) -> None:
    """Trains the head. The convolutions of the classifier do not change."""
    features, targets = training
    start = time.monotonic()
    trainable = [parameter for parameter in detector.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(trainable, lr=PEAK_RATE, weight_decay=0.02)
    steps = max(1, len(features) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, PEAK_RATE, total_steps=epochs * steps, pct_start=0.2)
    rng = np.random.default_rng(SEED)
    for epoch in range(epochs):
        order = torch.from_numpy(rng.permutation(len(features)))
        losses = []
        for chosen in order[: steps * BATCH].split(BATCH):
            loss = loss_of(detector, features[chosen], targets[chosen])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            losses.append(loss.item())
        print(f"epoch {epoch + 1}: loss {np.mean(losses):.4f}, {time.monotonic() - start:.0f} s", flush=True)


def write_pictures(folder: Path, count: int) -> None:
    """Writes test pictures, 640 pixels wide, and labels.csv.

    labels.csv has a line for each defect. A picture without defects has one line, without label and box.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "labels.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("file", "label", "left", "top", "right", "bottom"))
        for index in range(count):
            seed, label, name = PICTURE_SEEDS + index, LABELS[index % len(LABELS)], f"part-{index + 1:04}.jpg"
            draw.draw_picture(seed, label, 640).save(folder / name, quality=80, optimize=True)
            defects = boxes.boxes(scenes.sample(seed, label), 640)
            for box in defects:
                edges = (box.left, box.top, box.right, box.bottom)
                rows.writerow((name, boxes.NAMES[box.kind], *(f"{edge:.1f}" for edge in edges)))
            if not defects:
                rows.writerow((name, "", "", "", "", ""))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Trains the detector of defects.")
    parser.add_argument("classifier", type=Path, help="folder of the trained classifier")
    parser.add_argument("out", type=Path, help="the detector's folder")
    parser.add_argument("--scenes", type=int, default=320)
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    parser.add_argument("--pictures", type=int, default=24, help="number of test pictures")
    parser.add_argument("--workers", type=int, default=2, help="processes that draw")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(SEED)
    torch.set_num_threads(1)
    write_pictures(options.out / "pictures", options.pictures)
    detector = Detector(options.classifier)
    start = time.monotonic()
    training = draw_training_set(detector, TRAINING_SEEDS, options.scenes, options.workers)
    print(f"drew {options.scenes} scenes in {time.monotonic() - start:.0f} s", flush=True)
    train(detector, training, options.epochs)
    example = torch.zeros(1, 3, HEIGHT, WIDTH)
    path = options.out / "model.onnx"
    torch.onnx.export(
        detector.eval(),
        example,
        str(path),
        input_names=["image"],
        output_names=["boxes"],
        dynamic_axes={"image": {0: "batch"}, "boxes": {0: "batch"}},
        opset_version=OPSET,
    )
    text = CARD.format(
        width=WIDTH,
        height=HEIGHT,
        scale=SCALE,
        mean=list(MEAN),
        std=list(STD),
        labels=json.dumps(list(boxes.NAMES)),
        seed=SEED,
        scenes=options.scenes,
        first=TRAINING_SEEDS,
        last=TRAINING_SEEDS + options.scenes - 1,
        digest=hashlib.sha256(path.read_bytes()).hexdigest(),
    )
    (options.out / "model.toml").write_text(text)


if __name__ == "__main__":
    main()
