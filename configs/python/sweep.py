"""A user-defined sensor: any object with sample()."""

import math


class Lidar:
    """Imitates a laser scanner that turns in a square room: 360 distances in metres."""

    def __init__(self):
        self.turns = 0

    def sample(self):
        self.turns += 1
        return [round(2.0 / max(abs(math.cos(a)), abs(math.sin(a))), 4) for a in self.angles()]

    def angles(self):
        return [math.radians(degree + self.turns) for degree in range(360)]
