"""Measures how success depends on delay, without PEERNet: the policy in a loop with the simulated arm.

    evaluate.py models/teleoperation-policy --delays 0 0.02 0.1 0.3 0.67 --episodes 30

Each step takes a constant delay, during which the arm follows the previous action, as in robot.py.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Callable

import numpy as np
from PIL import Image

from simulator import PERIOD, Simulator, episode_rng, teacher

STEPS = 30


class Policy:
    """The exported policy, on one thread, with the preprocessing of its card."""

    def __init__(self, folder: Path) -> None:
        import onnxruntime
        import tomllib

        card = tomllib.loads((folder / "model.toml").read_text())
        self.names = [one["name"] for one in card["input"]]
        self.steps = card["preprocessing"]
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(str(folder / "model.onnx"), options, ["CPUExecutionProvider"])
        self.seconds: list[float] = []

    def velocity(self, simulator: Simulator) -> np.ndarray:
        """Returns the velocity of the tip for the current pictures, m/s."""
        inputs = dict(zip(self.names, (self.preprocessed(pixels) for pixels in simulator.render())))
        start = time.perf_counter()
        velocity = self.session.run(None, inputs)[0]
        self.seconds.append(time.perf_counter() - start)
        return velocity[0]

    def preprocessed(self, pixels: np.ndarray) -> np.ndarray:
        """Returns a picture as the network's input."""
        size = (self.steps["resize"]["width"], self.steps["resize"]["height"])
        values = np.asarray(Image.fromarray(pixels).resize(size, Image.BILINEAR), np.float32)
        values = (values * self.steps["scale"] - self.steps["mean"]) / self.steps["std"]
        return values.transpose(2, 0, 1)[np.newaxis].astype(np.float32)


def teacher_velocity(simulator: Simulator) -> np.ndarray:
    """Returns the teacher's action, which knows the positions."""
    return teacher(simulator.target - simulator.tip)


def steps_to_success(
    simulator: Simulator, velocity: Callable[[Simulator], np.ndarray], episode: int, delay: float, jitter: np.random.Generator | None
) -> int | None:
    """Runs an episode and returns the number of its steps, or None without success."""
    simulator.reset(episode_rng(episode))
    for step in range(1, STEPS + 1):
        action = velocity(simulator)
        # The controller judges the state that the pictures of this step show.
        if simulator.success:
            return step
        # Log-normal, as latencies of networks are: positive, and few are much longer than the others.
        simulator.advance(delay if jitter is None else delay * jitter.lognormal(0, 0.25))
        simulator.act(action)
        simulator.advance(PERIOD)
    return None


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Measures how success depends on delay.")
    parser.add_argument("model", type=Path, nargs="?", help="folder of the policy; without it the teacher acts, without pictures")
    parser.add_argument("--delays", type=float, nargs="+", default=[0, 0.02, 0.1, 0.3, 0.67], help="seconds per step")
    parser.add_argument("--episodes", type=int, default=30)
    parser.add_argument("--size", default="640x480", help="size at which pictures are rendered")
    parser.add_argument("--jitter", action="store_true", help="log-normal delays with a standard deviation of a quarter")
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))
    simulator = Simulator(width, height)
    policy = Policy(options.model) if options.model else None
    velocity = policy.velocity if policy else teacher_velocity
    for delay in options.delays:
        jitter = np.random.default_rng(0) if options.jitter else None
        found = [steps_to_success(simulator, velocity, episode, delay, jitter) for episode in range(options.episodes)]
        steps = [one for one in found if one is not None]
        mean = f"{np.mean(steps):.1f} steps (most {max(steps)})" if steps else "no steps"
        print(f"delay {delay:.3f} s: {len(steps)} of {len(found)} episodes succeed, {mean}", flush=True)
    if policy:
        print(f"inference: median {1000 * np.median(policy.seconds):.2f} ms on one thread")


if __name__ == "__main__":
    main()
