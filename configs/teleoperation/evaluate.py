"""Measures how success depends on delay, without PEERNet: the policy in a loop with the simulated arm.

    evaluate.py models/teleoperation-policy --delays 0 0.02 0.1 0.3 0.67 --episodes 30

Each step has a delay, during which the arm follows the previous action, as in robot.py. The delay is constant, or random with --jitter.
Without a model, the teacher controls the arm.
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
    """The exported policy, computed on one thread, with the preprocessing that its card describes."""

    def __init__(self, folder: Path) -> None:
        import onnxruntime
        import tomllib

        card = tomllib.loads((folder / "model.toml").read_text())
        self.input_names = [model_input["name"] for model_input in card["input"]]
        self.preprocessing = card["preprocessing"]
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(str(folder / "model.onnx"), options, ["CPUExecutionProvider"])
        # Duration of each inference, seconds.
        self.durations: list[float] = []

    def velocity(self, simulator: Simulator) -> np.ndarray:
        """Returns the velocity of the tip for the current pictures, m/s."""
        inputs = dict(zip(self.input_names, map(self.preprocess, simulator.render())))
        start = time.perf_counter()
        velocity = self.session.run(None, inputs)[0]
        self.durations.append(time.perf_counter() - start)
        return velocity[0]

    def preprocess(self, pixels: np.ndarray) -> np.ndarray:
        """Returns a picture as the network's input."""
        size = (self.preprocessing["resize"]["width"], self.preprocessing["resize"]["height"])
        values = np.asarray(Image.fromarray(pixels).resize(size, Image.BILINEAR), np.float32)
        values = (values * self.preprocessing["scale"] - self.preprocessing["mean"]) / self.preprocessing["std"]
        return values.transpose(2, 0, 1)[np.newaxis].astype(np.float32)


def teacher_velocity(simulator: Simulator) -> np.ndarray:
    """Returns the action of the teacher, which knows the positions of tip and target."""
    return teacher(simulator.target - simulator.tip)


def steps_to_success(
    simulator: Simulator,
    choose_velocity: Callable[[Simulator], np.ndarray],
    episode: int,
    delay: float,
    jitter: np.random.Generator | None,
) -> int | None:
    """Runs an episode. Returns the number of steps until success, or None if there is none within STEPS."""
    simulator.reset(episode_rng(episode))
    for step in range(1, STEPS + 1):
        action = choose_velocity(simulator)
        # As in robot.py, success is judged by the state that the pictures of this step show.
        if simulator.success:
            return step
        # Log-normal, like latencies of networks: always positive, and a few are much longer than the others.
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
    parser.add_argument("--jitter", action="store_true", help="log-normal delays whose standard deviation is about a quarter of the delay")
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))
    simulator = Simulator(width, height)
    policy = Policy(options.model) if options.model else None
    choose_velocity = policy.velocity if policy else teacher_velocity
    for delay in options.delays:
        jitter = np.random.default_rng(0) if options.jitter else None
        results = [steps_to_success(simulator, choose_velocity, episode, delay, jitter) for episode in range(options.episodes)]
        steps = [count for count in results if count is not None]
        steps_text = f", in {np.mean(steps):.1f} steps on average and at most {max(steps)}" if steps else ""
        print(f"delay {delay:.3f} s: {len(steps)} of {len(results)} episodes succeed{steps_text}", flush=True)
    if policy:
        print(f"inference: median {1000 * np.median(policy.durations):.2f} ms on one thread")


if __name__ == "__main__":
    main()
