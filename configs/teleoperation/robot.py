"""The robot of the teleoperation experiment, as PEERNet uses it: two cameras are the sensor, and the controller of the arm is the actuator.

    sensor = { kind = "python", object = "robot::Cameras", folder = "configs/teleoperation" }
    actuator = { kind = "socket", address = "udp://127.0.0.1:9006", feedback = true }

Environment variables: TELEOPERATION_SIZE, size of the pictures (default 640x480), and TELEOPERATION_PORT, UDP port of the controller
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

# Largest payload of a UDP datagram over IPv4.
MAX_LINE_BYTES = 65507


class Cameras:
    """Sensor: the pictures of both cameras. The same object contains the controller, which receives the actions over UDP.

    Simulated time passes in advance() only, between two iterations. So success depends on the measured latency of each iteration, and
    not on how fast this machine simulates and renders.
    """

    def __init__(self) -> None:
        self.simulator = Simulator(*picture_size())
        # Protects the state of the arm and the received action, because the controller has its own thread.
        self.lock = threading.Lock()
        # Velocity that was received since the last advance(), m/s.
        self.received: np.ndarray | None = None
        self.episode = -1
        self.controller = controller_socket()
        threading.Thread(target=self.serve, daemon=True).start()

    def reset(self) -> None:
        """Begins the next episode. Its target depends on its number and the repeat only, so that configurations are compared on the same targets."""
        self.episode += 1
        with self.lock:
            self.received = None
            self.simulator.reset(episode_rng(self.episode))
            self.render()

    def advance(self, seconds: float) -> None:
        """Lets simulated time pass: the total of the last iteration, in seconds, and then one control period.

        During the iteration the arm follows the previous action, because the new action arrives only at the end of the iteration.
        Then the arm follows the new action for PERIOD. An iteration without any delay is thus a step of an ideal controller at 20 Hz.
        If no action was received, the arm keeps following the previous one.
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
        """Returns the pictures of the tripod camera and the wrist camera. They are already rendered, so this takes almost no time."""
        return self.pictures

    def render(self) -> None:
        """Renders the pictures for the next sample. The caller holds the lock."""
        tripod, wrist = self.simulator.render()
        self.pictures = (Image.fromarray(tripod), Image.fromarray(wrist))

    def serve(self) -> None:
        """Answers each action with its feedback, or with a line that says why the action is invalid."""
        while True:
            line, sender = self.controller.recvfrom(MAX_LINE_BYTES)
            # If the line is invalid, the number of the iteration is unknown. PEERNet assigns a reply without the number to the current
            # iteration.
            reply: dict[str, Any] = {}
            try:
                action = parse_json(line)
                if isinstance(action, dict) and "iteration" in action:
                    reply["iteration"] = action["iteration"]
                reply.update(self.receive(read_velocity(action)))
            except Exception as error:
                # PEERNet rejects feedback with the key error, so the iteration fails and shows this text. The controller continues.
                reply = {"error": str(error), **reply}
            self.controller.sendto(json.dumps(reply).encode(), sender)

    def receive(self, velocity: np.ndarray) -> dict[str, Any]:
        """Stores the action for advance(). Returns feedback on the state that the pictures of this iteration show."""
        with self.lock:
            self.received = velocity
            reached = self.simulator.success
            return {"reward": -self.simulator.distance, "success": reached, "episode_ended": reached}


def parse_json(line: bytes) -> object:
    """Returns the value of a line of JSON."""
    try:
        return json.loads(line)
    except ValueError as error:
        raise ValueError(f"expected a line of JSON: {error}") from error


def read_velocity(action: object) -> np.ndarray:
    """Returns the velocity [x, y, z] in m/s from the key answer of an action, which has it as [x, y, z] or [[x, y, z]]."""
    # The text is short, because PEERNet quotes only the first 120 bytes of a line that is not valid feedback.
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
        raise ValueError(f"TELEOPERATION_SIZE={text!r} is not a picture size; expected WIDTHxHEIGHT in pixels, such as 640x480")
    return int(match[1]), int(match[2])


def controller_socket() -> socket.socket:
    """Returns the socket on which the controller receives actions, bound to the port TELEOPERATION_PORT."""
    text = os.environ.get("TELEOPERATION_PORT", "9006")
    if not text.isdecimal() or not 0 < int(text) < 65536:
        raise ValueError(f"TELEOPERATION_PORT={text!r} is not a port; expected a number from 1 to 65535")
    controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        controller.bind(("127.0.0.1", int(text)))
    except OSError as error:
        raise OSError(
            f"the controller of the arm cannot listen on UDP 127.0.0.1:{text}: {error}; stop the program that uses this port, or set "
            "TELEOPERATION_PORT and the actuator's address to another port"
        ) from error
    return controller
