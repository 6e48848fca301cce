"""A logger that does the work of the published program's: a tree of small objects that is pickled with every message.

Nodes start when they are made, read the wall clock, and are found by walking the tree. Nothing more than the
comparison needs.
"""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any


class Container:
    """A node that only has children."""

    kind = "Container"

    def __init__(self, name: str, depth: int = 0) -> None:
        self.name = name
        self.depth = depth
        self.metric_name = self.kind
        self.children: list[Container] = []
        self.start_collection()
        self.end = None
        self.metric: Any = None

    def _tic(self) -> None:
        pass

    def _toc(self, *values: Any) -> Any:
        return None

    def log_section(self, name: str, kind: type[Container]) -> Container:
        """A new child."""
        child = kind(name, self.depth + 1)
        self.children.append(child)
        return child

    def start_collection(self) -> None:
        self._tic()

    def end_collection(self, *values: Any) -> None:
        self.metric = self._toc(*values)

    def end_sub(self, name: str, *values: Any) -> None:
        """Ends the node of this name, which may have been opened on another host."""
        if self.name == name:
            self.end_collection(*values)
            return
        for child in self.children:
            child.end_sub(name, *values)

    def get_metric(self, name: str) -> Any:
        """A child's metric, -1 when absent."""
        for child in self.children:
            if child.name == name:
                return child.metric
        return -1

    def child(self, name: str) -> Container:
        """The child of this name."""
        return next(child for child in self.children if child.name == name)


class Timer(Container):
    """Seconds from its start to its end."""

    kind = "Time"

    def _tic(self) -> None:
        self.start = time.time()

    def _toc(self, *values: Any) -> float:
        return time.time() - self.start


class Value(Container):
    """A number."""

    kind = "Value"

    def _toc(self, *values: Any) -> Any:
        return values[0] if values else None


class Timing:
    """`with Timing(logger, "sensing"): …`"""

    def __init__(self, parent: Container, name: str) -> None:
        self.parent = parent
        self.name = name

    def __enter__(self) -> Container:
        self.section = self.parent.log_section(self.name, Timer)
        return self.section

    def __exit__(self, *_: object) -> None:
        self.section.end_collection()


def write_csv(path: Path, iterations: list[Container]) -> None:
    """One row per iteration, one column per node."""
    names = [child.name for child in iterations[0].children]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["iteration", *names])
        for number, iteration in enumerate(iterations):
            writer.writerow([number, *(child.metric for child in iteration.children)])
