"""Draws the training set, trains the network, and writes model.onnx and its card.

    train.py models/quality-control

Takes about 25 minutes on two cores. Nothing is downloaded.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn

import card
import dataset
from dataset import WIDTHS, Dataset
from network import Network
from preprocessing import HEIGHT, MEAN, STD, WIDTH, normalise
from scene import LABELS

SEED = 7
TRAINING_SEEDS = 1_000_000  # first seed of the scenes of the training set
VALIDATION_SEEDS = 2_000_000  # first seed of the scenes with which the progress is measured
SCENES, VALIDATION_SCENES = 3600, 240
EPOCHS, BATCH, PEAK_RATE = 16, 16, 2e-3
CELL_WEIGHT = 10.0  # weight of a cell that shows a defect; the weight of other cells is 1
LOCATION_WEIGHT = 20.0  # weight of the loss of the maps; the weight of the loss of the label is 1
OPSET = 13


def train(training: Dataset, validation: Dataset, epochs: int) -> Network:
    """Trains a network on `training`, and prints its accuracy on `validation` after each epoch."""
    torch.manual_seed(SEED)
    torch.set_num_threads(1)
    start = time.monotonic()
    network = Network(len(LABELS) - 1)
    optimiser = torch.optim.AdamW(network.parameters(), lr=PEAK_RATE, weight_decay=0.02)
    steps = len(training.labels) // BATCH
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, PEAK_RATE, total_steps=epochs * steps, pct_start=0.25)
    rng = np.random.default_rng(SEED)
    for epoch in range(epochs):
        network.train()
        order = rng.permutation(len(training.labels))
        losses = []
        for step in range(steps):
            loss = loss_of(network, training, order[step * BATCH : (step + 1) * BATCH], rng)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            losses.append(loss.item())
        accuracies = [accuracy(network, validation.pictures[:, k], validation.labels) for k in range(len(WIDTHS))]
        print(
            f"epoch {epoch + 1}: loss {np.mean(losses):.4f}, validation {accuracies}, {time.monotonic() - start:.0f} s",
            flush=True,
        )
    return network.eval()


def loss_of(network: Network, training: Dataset, chosen: np.ndarray, rng: np.random.Generator) -> torch.Tensor:
    """The loss of a batch: of the labels, and of the maps that locate the defects."""
    variant = rng.integers(0, len(WIDTHS), len(chosen))
    pictures, targets = augment_batch(training.pictures[chosen, variant], training.maps[chosen], rng)
    maps = network.maps(pictures)
    class_loss = nn.functional.cross_entropy(
        network.classify(maps), torch.from_numpy(training.labels[chosen]), label_smoothing=0.02
    )
    weight = torch.full((1, 1, 1), CELL_WEIGHT)
    location_loss = nn.functional.binary_cross_entropy_with_logits(maps, targets, pos_weight=weight)
    return class_loss + LOCATION_WEIGHT * location_loss


def augment_batch(pixels: np.ndarray, maps: np.ndarray, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """A batch that is mirrored at random, with random changes of its brightness and colour.

    Bytes [n, height, width, 3] become the network's input [n, 3, height, width].
    The maps of the defects, bool [n, defects, rows, columns], are mirrored with their pictures.
    """
    n = len(pixels)
    values = torch.from_numpy(pixels).permute(0, 3, 1, 2).contiguous().float() / 255
    gain = rng.uniform(0.85, 1.15, (n, 1, 1, 1)) * rng.uniform(0.95, 1.05, (n, 3, 1, 1))
    lift = rng.uniform(-0.03, 0.03, (n, 1, 1, 1))
    values = (values * torch.from_numpy(gain).float() + torch.from_numpy(lift).float()).clamp(0, 1)
    batch = (values - torch.tensor(MEAN).view(3, 1, 1)) / torch.tensor(STD).view(3, 1, 1)
    targets = torch.from_numpy(maps).float()
    for axis in (2, 3):
        mirrored = torch.from_numpy(rng.random(n) < 0.5)
        batch[mirrored] = batch[mirrored].flip(axis)
        targets[mirrored] = targets[mirrored].flip(axis)
    return batch, targets


def accuracy(network: Network, pixels: np.ndarray, labels: np.ndarray) -> float:
    """Fraction of the pictures, bytes [n, height, width, 3], that the network classifies correctly."""
    network.eval()
    with torch.no_grad():
        is_correct = [
            int(network(torch.from_numpy(normalise(picture))).argmax()) == label
            for picture, label in zip(pixels, labels, strict=True)
        ]
    return round(float(np.mean(is_correct)), 4)


def export(network: Network, path: Path) -> None:
    """Writes the network as ONNX: input `image`, output `logits`, fixed shapes, batches of one picture."""
    example = torch.zeros(1, 3, HEIGHT, WIDTH)
    torch.onnx.export(network, example, str(path), input_names=["image"], output_names=["logits"], opset_version=OPSET)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Trains the quality-control model.")
    parser.add_argument("out", type=Path, help="the model's folder")
    parser.add_argument("--scenes", type=int, default=SCENES)
    parser.add_argument("--validation-scenes", type=int, default=VALIDATION_SCENES)
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    parser.add_argument("--workers", type=int, default=2, help="processes that draw")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    start = time.monotonic()
    training = dataset.draw_dataset(TRAINING_SEEDS, options.scenes, options.workers)
    validation = dataset.draw_dataset(VALIDATION_SEEDS, options.validation_scenes, options.workers)
    drawn = options.scenes + options.validation_scenes
    print(f"drew {drawn} scenes in {time.monotonic() - start:.0f} s", flush=True)
    network = train(training, validation, options.epochs)
    export(network, options.out / "model.onnx")
    card.write(options.out, SEED, TRAINING_SEEDS, options.scenes)


if __name__ == "__main__":
    main()
