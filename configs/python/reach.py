"""A simulated arm with its controller, and a policy: a closed loop in episodes."""

import json
import os
import random
import socket
import threading

CONTROLLER = ("127.0.0.1", 9005)
# Largest distance in one step, and distance from the target below which the target is reached; metres.
REACH, TOLERANCE = 0.15, 0.02


class Arm:
    """Sensor: the position of a hand on a line. Its controller moves the hand when it gets an action over UDP."""

    def __init__(self):
        # An experiment gives each repeat a seed; without one, the targets are always the same.
        self.random = random.Random(int(os.environ.get("PEERNET_SEED", 1)))
        self.lock = threading.Lock()
        self.controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.controller.bind(CONTROLLER)
        threading.Thread(target=self.serve, daemon=True).start()

    def reset(self):
        """Begins an episode with another target."""
        with self.lock:
            self.position, self.target = 0.0, self.random.uniform(-1.0, 1.0)

    def sample(self):
        with self.lock:
            return {"position": self.position, "target": self.target}

    def serve(self):
        while True:
            line, sender = self.controller.recvfrom(65507)
            action = json.loads(line)
            feedback = self.move(action["answer"]["move"])
            # The number lets the actuator ignore a copy of the datagram.
            feedback["iteration"] = action["iteration"]
            self.controller.sendto(json.dumps(feedback).encode(), sender)

    def move(self, distance):
        with self.lock:
            self.position += max(-REACH, min(REACH, distance))
            error = abs(self.target - self.position)
        reached = error < TOLERANCE
        return {"reward": -error, "success": reached, "episode_ended": reached}


class Policy:
    """Model: half of the way to the target in each step."""

    def infer(self, state):
        return {"move": (state["target"] - state["position"]) / 2}
