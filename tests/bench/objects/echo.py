"""A sensor and a model in the published style, for the part `python`."""

import os


class Source:
    """The same bytes over and over."""

    def __init__(self):
        self.data = os.urandom(int(os.environ["BENCH_BYTES"]))

    def sample(self):
        return self.data


class Echo:
    """Answers with what it was given."""

    def infer(self, x):
        return x
