"""Trains the policy of the teleoperation experiment: a small network that imitates the teacher from two pictures.

    train.py models/teleoperation-policy

The teacher (simulator.py) knows the positions of tip and target; the network has to find them in the pictures. It is trained on random
states of the arm, rendered with both cameras. A spatial softmax finds key points in each picture (Levine et al., End-to-end training
of deep visuomotor policies, JMLR 2016; Finn et al., Deep spatial autoencoders, ICRA 2016). The network computes the vector from the tip
to the target from the key points. The exported graph also applies the gain and the speed limit. requirements.txt says how to install the
packages that this script needs.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import nn

from simulator import CUP_RANGE, GAIN, SPEED_LIMIT, START, WORKSPACE, Simulator

SEED = 9_000_000
WIDTH, HEIGHT = 96, 72
# Sizes at which pictures are rendered, in turn, before they are resized to the network's input. Edges look different at each size.
SIZES = ((192, 144), (192, 144), (192, 144), (320, 240), (192, 144), (192, 144), (192, 144), (640, 480))
MEAN, STD = 0.5, 0.25
# Channels of the convolutions, and key points per picture.
CHANNELS, POINTS = 16, 12
EPOCHS, BATCH, PEAK_LEARNING_RATE = 20, 64, 4e-3
OPSET = 13

CARD = """\
name = "teleoperation-policy"
task = "tensors"
description = "Moves the pen of a simulated arm to a cup, from the pictures of two cameras: velocity of the tip in m/s."
version = "1"

[[input]]
name = "tripod"
dtype = "float32"
layout = "nchw"
shape = [1, 3, {height}, {width}]
colour = "rgb"

[[input]]
name = "wrist"
dtype = "float32"
layout = "nchw"
shape = [1, 3, {height}, {width}]
colour = "rgb"

[preprocessing]
resize = {{ mode = "exact", width = {width}, height = {height}, filter = "bilinear", antialias = true }}
scale = 0.00392156862745098
mean = [{mean}, {mean}, {mean}]
std = [{std}, {std}, {std}]

[[output]]
name = "velocity"
dtype = "float32"
shape = [1, 3]

[provenance]
script = "configs/teleoperation/train.py"
seed = {seed}
trained_on = "{states} random states of the simulated arm in configs/teleoperation, with the teacher's answers"
error_mm = {error:.1f}
sha256 = "{digest}"
licence = "MIT OR Apache-2.0"
"""


class KeyPoints(nn.Module):
    """Finds key points in pictures [n, 3, height, width]. Output [n, 3 * POINTS]: x and y of each, from -1 to 1, then the strengths."""

    def __init__(self) -> None:
        super().__init__()
        self.maps = nn.Sequential(
            nn.Conv2d(3, CHANNELS, 5, stride=2, padding=2),
            nn.ReLU(),
            nn.Conv2d(CHANNELS, CHANNELS, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(CHANNELS, POINTS, 3, padding=2, dilation=2),
        )
        rows, columns = torch.meshgrid(torch.linspace(-1, 1, HEIGHT // 2), torch.linspace(-1, 1, WIDTH // 2), indexing="ij")
        self.register_buffer("places", torch.stack([columns.flatten(), rows.flatten()], dim=1))

    def forward(self, picture: torch.Tensor) -> torch.Tensor:
        """Returns the positions and strengths of the key points."""
        maps = self.maps(picture).flatten(2)
        positions = torch.matmul(maps.softmax(dim=2), self.places)
        return torch.cat([positions.flatten(1), torch.tanh(maps.amax(dim=2) / 10)], dim=1)


class Policy(nn.Module):
    """Computes the velocity of the tip [n, 3], m/s, from the pictures of the tripod camera and the wrist camera."""

    def __init__(self) -> None:
        super().__init__()
        self.tripod, self.wrist = KeyPoints(), KeyPoints()
        self.head = nn.Sequential(nn.Linear(6 * POINTS, 128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU(), nn.Linear(64, 3))

    def error(self, tripod: torch.Tensor, wrist: torch.Tensor) -> torch.Tensor:
        """Returns the vector from the tip to the target, metres."""
        return self.head(torch.cat([self.tripod(tripod), self.wrist(wrist)], dim=1))

    def forward(self, tripod: torch.Tensor, wrist: torch.Tensor) -> torch.Tensor:
        """Returns the output of the exported model: the teacher's rule, applied to the vector that the network estimates."""
        wanted = GAIN * self.error(tripod, wrist)
        speed = (wanted * wanted).sum(dim=1, keepdim=True).sqrt()
        return wanted * SPEED_LIMIT / speed.clamp(min=SPEED_LIMIT)


def resized(pixels: np.ndarray) -> np.ndarray:
    """Returns a picture as the card's preprocessing resizes it: [3, height, width] of bytes."""
    return np.asarray(Image.fromarray(pixels).resize((WIDTH, HEIGHT), Image.BILINEAR)).transpose(2, 0, 1)


def normalised(pixels: torch.Tensor) -> torch.Tensor:
    """Returns the network's input for pictures of bytes."""
    return (pixels.float() / 255 - MEAN) / STD


def render_states(count: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Renders random states: pictures [count, 2, 3, height, width] of bytes, vectors to the target [count, 3] in metres."""
    rng = np.random.default_rng(seed)
    simulators = {size: Simulator(*size) for size in SIZES}
    pictures, errors = np.zeros((count, 2, 3, HEIGHT, WIDTH), np.uint8), np.zeros((count, 3), np.float32)
    for index in range(count):
        simulator = simulators[SIZES[index % len(SIZES)]]
        cup = rng.uniform(CUP_RANGE[0] - 0.02, CUP_RANGE[1] + 0.02)
        target = np.array([*cup, simulator.target_height])
        kind = rng.random()
        if kind < 0.5:
            # Success is decided near the target, so half of the states are there, at distances from 3 to 160 mm.
            direction = rng.normal(size=3)
            tip = target + direction / np.linalg.norm(direction) * 10 ** rng.uniform(-2.5, -0.8)
        elif kind < 0.7:
            # On the straight way from the start to the target, with some deviation.
            tip = START + rng.random() * (target - START) + rng.normal(scale=0.03, size=3)
        else:
            tip = rng.uniform(*WORKSPACE)
        simulator.place(np.clip(tip, *WORKSPACE), cup)
        # A moving hand never points exactly down.
        simulator.turn_joints(rng.normal(scale=0.01, size=simulator.model.nv))
        pictures[index] = [resized(picture) for picture in simulator.render()]
        errors[index] = simulator.target - simulator.tip
    return torch.from_numpy(pictures), torch.from_numpy(errors)


def augmented(pictures: torch.Tensor) -> torch.Tensor:
    """Returns normalised pictures with small random changes of brightness and contrast, and with noise like that of JPEG compression."""
    count = len(pictures)
    values = normalised(pictures) * (1 + 0.05 * torch.randn(count, 1, 1, 1)) + 0.05 * torch.randn(count, 1, 1, 1)
    return values + 0.05 * torch.rand(count, 1, 1, 1) * torch.randn_like(values)


def train(policy: Policy, pictures: torch.Tensor, errors: torch.Tensor, epochs: int) -> None:
    """Trains all weights of the policy to estimate the vectors to the target."""
    start = time.monotonic()
    optimiser = torch.optim.AdamW(policy.parameters(), lr=PEAK_LEARNING_RATE, weight_decay=1e-3)
    steps = len(pictures) // BATCH
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, PEAK_LEARNING_RATE, total_steps=epochs * steps, pct_start=0.2)
    for epoch in range(epochs):
        losses = []
        for chosen in torch.randperm(len(pictures))[: steps * BATCH].split(BATCH):
            estimated = policy.error(augmented(pictures[chosen, 0]), augmented(pictures[chosen, 1]))
            expected = errors[chosen]
            # The loss is relative to the distance: far from the target the speed is limited, so only the direction matters.
            loss = ((estimated - expected).norm(dim=1) / (0.02 + 0.2 * expected.norm(dim=1))).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            losses.append(loss.item())
        print(f"epoch {epoch + 1}: loss {np.mean(losses):.4f}, {time.monotonic() - start:.0f} s", flush=True)


def mean_error(policy: Policy, pictures: torch.Tensor, errors: torch.Tensor) -> float:
    """Returns the mean error of the estimated vector, millimetres, for states whose tip is within 10 cm of the target."""
    near = errors.norm(dim=1) < 0.1
    with torch.no_grad():
        estimated = policy.error(normalised(pictures[near, 0]), normalised(pictures[near, 1]))
    return 1000 * float((estimated - errors[near]).norm(dim=1).mean())


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Trains the policy of the teleoperation experiment.")
    parser.add_argument("out", type=Path, help="the model's folder")
    parser.add_argument("--states", type=int, default=6400, help="number of states to train on")
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(SEED)
    torch.set_num_threads(options.threads)
    start = time.monotonic()
    training = render_states(options.states, SEED)
    held_out = render_states(max(64, options.states // 16), SEED + 1)
    print(f"rendered {options.states} states in {time.monotonic() - start:.0f} s", flush=True)
    policy = Policy()
    train(policy, *training, options.epochs)
    error = mean_error(policy.eval(), *held_out)
    path, example = options.out / "model.onnx", torch.zeros(1, 3, HEIGHT, WIDTH)
    names = {"input_names": ["tripod", "wrist"], "output_names": ["velocity"]}
    torch.onnx.export(policy, (example, example), str(path), opset_version=OPSET, **names)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    facts = {"width": WIDTH, "height": HEIGHT, "mean": MEAN, "std": STD, "seed": SEED, "states": options.states}
    (options.out / "model.toml").write_text(CARD.format(error=error, digest=digest, **facts))
    print(f"mean error within 10 cm of the target: {error:.1f} mm; {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
