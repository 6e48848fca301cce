"""Trains the policy of the teleoperation experiment: a small network that imitates the teacher from two pictures.

    train.py models/teleoperation-policy

The teacher (simulator.py) knows the positions of tip and target; the network has to find them in the pictures. It is trained on random
states of the arm, rendered with both cameras. It finds key points in each picture by a spatial softmax (Levine et al., End-to-end training of
deep visuomotor policies, JMLR 2016; Finn et al., Deep spatial autoencoders, ICRA 2016) and computes the vector from the tip to the target
from them. Gain and speed limit are part of the exported graph. requirements.txt says how to install what it needs.
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
# Sizes at which states are rendered, in turn, before they are resized: edges look different at each size.
SIZES = ((192, 144), (192, 144), (192, 144), (320, 240), (192, 144), (192, 144), (192, 144), (640, 480))
MEAN, STD = 0.5, 0.25
CHANNELS, POINTS = 16, 12
EPOCHS, BATCH, PEAK_RATE = 20, 64, 4e-3
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
    """Positions from -1 to 1 and strengths of what the network looks for in pictures: [n, 3, height, width] to [n, 3 * POINTS]."""

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
        """Returns positions and strengths in one vector."""
        maps = self.maps(picture).flatten(2)
        positions = torch.matmul(maps.softmax(dim=2), self.places)
        return torch.cat([positions.flatten(1), torch.tanh(maps.amax(dim=2) / 10)], dim=1)


class Policy(nn.Module):
    """Velocity of the tip [n, 3], m/s, from the pictures of the tripod's and the wrist's camera."""

    def __init__(self) -> None:
        super().__init__()
        self.tripod, self.wrist = KeyPoints(), KeyPoints()
        self.head = nn.Sequential(nn.Linear(6 * POINTS, 128), nn.ReLU(), nn.Linear(128, 64), nn.ReLU(), nn.Linear(64, 3))

    def error(self, tripod: torch.Tensor, wrist: torch.Tensor) -> torch.Tensor:
        """Returns the vector from the tip to the target, metres."""
        return self.head(torch.cat([self.tripod(tripod), self.wrist(wrist)], dim=1))

    def forward(self, tripod: torch.Tensor, wrist: torch.Tensor) -> torch.Tensor:
        """The output of the exported model: the teacher's rule for the vector that the network sees."""
        wanted = GAIN * self.error(tripod, wrist)
        speed = (wanted * wanted).sum(dim=1, keepdim=True).sqrt()
        return wanted * SPEED_LIMIT / speed.clamp(min=SPEED_LIMIT)


def resized(pixels: np.ndarray) -> np.ndarray:
    """Returns a picture as the card's preprocessing resizes it: [3, height, width] of bytes."""
    return np.asarray(Image.fromarray(pixels).resize((WIDTH, HEIGHT), Image.BILINEAR)).transpose(2, 0, 1)


def normalised(pixels: torch.Tensor) -> torch.Tensor:
    """Returns bytes as the network's input."""
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
            # Success is decided near the target, so half of the states are there, at all scales down to 3 mm.
            direction = rng.normal(size=3)
            tip = target + direction / np.linalg.norm(direction) * 10 ** rng.uniform(-2.5, -0.8)
        elif kind < 0.7:
            # On the way from the start.
            tip = START + rng.random() * (target - START) + rng.normal(scale=0.03, size=3)
        else:
            tip = rng.uniform(*WORKSPACE)
        simulator.place(np.clip(tip, *WORKSPACE), cup)
        # A moving hand is never exactly upright.
        simulator.turn_joints(rng.normal(scale=0.01, size=simulator.model.nv))
        pictures[index] = [resized(picture) for picture in simulator.render()]
        errors[index] = simulator.target - simulator.tip
    return torch.from_numpy(pictures), torch.from_numpy(errors)


def augmented(pictures: torch.Tensor) -> torch.Tensor:
    """Returns normalised pictures with slightly other brightness, contrast and noise, as after JPEG compression."""
    count = len(pictures)
    values = normalised(pictures) * (1 + 0.05 * torch.randn(count, 1, 1, 1)) + 0.05 * torch.randn(count, 1, 1, 1)
    return values + 0.05 * torch.rand(count, 1, 1, 1) * torch.randn_like(values)


def train(policy: Policy, pictures: torch.Tensor, errors: torch.Tensor, epochs: int) -> None:
    """Trains all weights."""
    start = time.monotonic()
    optimiser = torch.optim.AdamW(policy.parameters(), lr=PEAK_RATE, weight_decay=1e-3)
    steps = len(pictures) // BATCH
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, PEAK_RATE, total_steps=epochs * steps, pct_start=0.2)
    for epoch in range(epochs):
        losses = []
        for chosen in torch.randperm(len(pictures))[: steps * BATCH].split(BATCH):
            found = policy.error(augmented(pictures[chosen, 0]), augmented(pictures[chosen, 1]))
            wanted = errors[chosen]
            # Relative to the distance, because only the direction counts far away, where the speed is limited.
            loss = ((found - wanted).norm(dim=1) / (0.02 + 0.2 * wanted.norm(dim=1))).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            losses.append(loss.item())
        print(f"epoch {epoch + 1}: loss {np.mean(losses):.4f}, {time.monotonic() - start:.0f} s", flush=True)


def precision(policy: Policy, pictures: torch.Tensor, errors: torch.Tensor) -> float:
    """Returns the mean error of the vector to the target for states within 10 cm of it, millimetres."""
    near = errors.norm(dim=1) < 0.1
    with torch.no_grad():
        found = policy.error(normalised(pictures[near, 0]), normalised(pictures[near, 1]))
    return 1000 * float((found - errors[near]).norm(dim=1).mean())


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
    seen = render_states(options.states, SEED)
    held_out = render_states(max(64, options.states // 16), SEED + 1)
    print(f"rendered {options.states} states in {time.monotonic() - start:.0f} s", flush=True)
    policy = Policy()
    train(policy, *seen, options.epochs)
    error = precision(policy.eval(), *held_out)
    path, example = options.out / "model.onnx", torch.zeros(1, 3, HEIGHT, WIDTH)
    names = {"input_names": ["tripod", "wrist"], "output_names": ["velocity"]}
    torch.onnx.export(policy, (example, example), str(path), opset_version=OPSET, **names)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    facts = {"width": WIDTH, "height": HEIGHT, "mean": MEAN, "std": STD, "seed": SEED, "states": options.states}
    (options.out / "model.toml").write_text(CARD.format(error=error, digest=digest, **facts))
    print(f"mean error within 10 cm of the target: {error:.1f} mm; {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
