"""A sensor and a model with the methods that the paper's program calls, for the part `python`."""

import os


class Source:
    """Sensor that yields the same bytes again and again."""

    def __init__(self):
        self.data = os.urandom(int(os.environ["BENCH_BYTES"]))

    def sample(self):
        return self.data


class Echo:
    """Model that returns its input."""

    def infer(self, x):
        return x
