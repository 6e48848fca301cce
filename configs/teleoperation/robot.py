"""The robot of the teleoperation experiment, as PEERNet uses it: two cameras as sensor, and the controller of the arm as actuator.

    sensor = { kind = "python", object = "robot::Cameras", folder = "configs/teleoperation" }
    actuator = { kind = "socket", address = "udp://127.0.0.1:9006", feedback = true }

Variables of the environment: TELEOPERATION_SIZE, size of the pictures (default 640x480), and TELEOPERATION_PORT, port of the controller
(default 9006).
"""

from __future__ import annotations

import json
import math
import os
import re
import socket
import threading
from typing import Any

import numpy as np
from PIL import Image

from simulator import PERIOD, Simulator, episode_rng

MAX_LINE_BYTES = 65507


class Cameras:
    """Sensor: the pictures of both cameras. The same object is the controller, which gets the actions over UDP.

    Time passes in advance() only, between two iterations. So success depends on the measured latency of each iteration and not on how
    fast this machine simulates and renders.
    """

    def __init__(self) -> None:
        self.simulator = Simulator(*picture_size())
        # Held while the state of the arm or the received action is read or changed: the controller has its own thread.
        self.lock = threading.Lock()
        self.received: np.ndarray | None = None
        self.episode = -1
        self.controller = controller_socket()
        threading.Thread(target=self.serve, daemon=True).start()

    def reset(self) -> None:
        """Begins an episode with another target. The targets are the same in each run, so that configurations are compared in pairs."""
        self.episode += 1
        with self.lock:
            self.received = None
            self.simulator.reset(episode_rng(self.episode))
            self.render()

    def advance(self, seconds: float) -> None:
        """Lets the time of the last iteration pass: its total in seconds, and then one period of the control.

        The arm follows the previous action during the iteration, because the new one comes only at its end. Then it follows the new
        one for PERIOD. An iteration without any delay is thus a step of an ideal controller at 20 Hz. If no action was received,
        the previous one stays.
        """
        if not (math.isfinite(seconds) and seconds >= 0):
            raise ValueError(f"advance() got {seconds} seconds; the total of an iteration is a finite number and not negative")
        with self.lock:
            action, self.received = self.received, None
            self.simulator.advance(seconds)
            if action is not None:
                self.simulator.act(action)
            self.simulator.advance(PERIOD)
            self.render()

    def sample(self) -> tuple[Image.Image, Image.Image]:
        """Returns the pictures of the tripod's and the wrist's camera. They are rendered before, so that this takes no time."""
        return self.pictures

    def render(self) -> None:
        """Renders the pictures for the next sample. The caller holds the lock."""
        tripod, wrist = self.simulator.render()
        self.pictures = (Image.fromarray(tripod), Image.fromarray(wrist))

    def serve(self) -> None:
        """Answers each action with its feedback, or with a line that says why it cannot be done."""
        while True:
            line, sender = self.controller.recvfrom(MAX_LINE_BYTES)
            # Without a valid line there is no number of the iteration; then PEERNet takes the reply for the current one.
            reply: dict[str, Any] = {}
            try:
                action = parsed(line)
                if isinstance(action, dict) and "iteration" in action:
                    reply["iteration"] = action["iteration"]
                reply.update(self.receive(velocity_of(action)))
            except Exception as error:
                # PEERNet refuses the key error, so the iteration fails with this text. The controller goes on.
                reply = {"error": str(error), **reply}
            self.controller.sendto(json.dumps(reply).encode(), sender)

    def receive(self, velocity: np.ndarray) -> dict[str, Any]:
        """Keeps an action until advance() and returns the feedback: on the state that the pictures of this iteration show."""
        with self.lock:
            self.received = velocity
            reached = self.simulator.success
            return {"reward": -self.simulator.distance, "success": reached, "episode_ended": reached}


def parsed(line: bytes) -> object:
    """Returns a line of JSON."""
    try:
        return json.loads(line)
    except ValueError as error:
        raise ValueError(f"expected a line of JSON: {error}") from error


def velocity_of(action: object) -> np.ndarray:
    """Returns the velocity in an action's answer, [x, y, z] or [[x, y, z]] in m/s."""
    # Short, because PEERNet quotes 120 bytes of a line that is not feedback.
    expected = "expected as answer [x, y, z] or [[x, y, z]] in m/s"
    if not isinstance(action, dict) or "answer" not in action:
        raise ValueError(f"{expected}, got a line without answer")
    try:
        velocity = np.asarray(action["answer"], float)
    except (TypeError, ValueError):
        velocity = np.zeros(0)
    if velocity.shape not in ((3,), (1, 3)) or not np.isfinite(velocity).all():
        raise ValueError(f"{expected}, got {json.dumps(action['answer'])[:40]}")
    return velocity.reshape(3)


def picture_size() -> tuple[int, int]:
    """Returns width and height of the pictures, from TELEOPERATION_SIZE."""
    text = os.environ.get("TELEOPERATION_SIZE", "640x480")
    match = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if match is None:
        raise ValueError(f"TELEOPERATION_SIZE={text!r} is no size of pictures; expected width x height in pixels, such as 640x480")
    return int(match[1]), int(match[2])


def controller_socket() -> socket.socket:
    """Returns the socket on which the controller receives actions; its port is from TELEOPERATION_PORT."""
    text = os.environ.get("TELEOPERATION_PORT", "9006")
    if not text.isdecimal() or not 0 < int(text) < 65536:
        raise ValueError(f"TELEOPERATION_PORT={text!r} is no port; expected a number from 1 to 65535")
    controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        controller.bind(("127.0.0.1", int(text)))
    except OSError as error:
        raise OSError(
            f"the controller of the arm cannot listen on UDP 127.0.0.1:{text}: {error}; stop the program that uses it, or set "
            "TELEOPERATION_PORT and the actuator's address to another port"
        ) from error
    return controller
