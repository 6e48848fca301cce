"""A logger that does the work of the logger of the paper's program: a tree of small objects that is pickled with every message.

Nodes start when they are created, read the wall clock, and are found by walking the tree. The logger has only what
the comparison needs.
"""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any


class Node:
    """A node of the tree; its kinds say what begins and ends a measurement, with whatever arguments they need."""

    def __init__(self, name: str, depth: int = 0) -> None:
        if "_" in name:
            raise ValueError(f"{name!r}: underscores join the names of columns")
        self.name = name
        self.depth = depth
        self.metric_name = "metric"
        self.children: list[Node] = []
        self.start_collection()
        self.end = None
        self.metric: Any = None

    def _tic(self, *args: Any, **kwargs: Any) -> None:
        raise NotImplementedError

    def _toc(self, *args: Any, **kwargs: Any) -> Any:
        raise NotImplementedError

    def log_section(self, name: str, kind: type[Node]) -> Node:
        """Adds a child and returns it."""
        child = kind(name, depth=self.depth + 1)
        self.children.append(child)
        return child

    def start_collection(self, *args: Any, **kwargs: Any) -> None:
        self._tic(*args, **kwargs)

    def end_collection(self, *args: Any, **kwargs: Any) -> None:
        self.metric = self._toc(*args, **kwargs)

    def end_sub(self, name: str, *args: Any, **kwargs: Any) -> None:
        """Ends the node of this name, which may have been opened on another host."""
        if self.name == name:
            self.end_collection(*args, **kwargs)
            return
        for child in self.children:
            child.end_sub(name, *args, **kwargs)

    def get_metric(self, name: str) -> Any:
        """A child's metric, -1 when absent."""
        for child in self.children:
            if child.name == name:
                return child.metric
        return -1

    def child(self, name: str) -> Node:
        """The child of this name."""
        return next(child for child in self.children if child.name == name)


class Container(Node):
    """Only has children."""

    def __init__(self, name: str, depth: int = 0) -> None:
        super().__init__(name, depth)
        self.metric_name = "Container"

    def _tic(self) -> None:
        pass

    def _toc(self) -> Any:
        return None


class Timer(Node):
    """Seconds from its start to its end."""

    def __init__(self, name: str, depth: int = 0) -> None:
        super().__init__(name, depth)
        self.metric_name = "Time"

    def _tic(self) -> None:
        self.start = time.time()

    def _toc(self) -> float:
        return time.time() - self.start


class Value(Node):
    """A number."""

    def __init__(self, name: str, depth: int = 0) -> None:
        super().__init__(name, depth)
        self.metric_name = "Value"

    def _tic(self) -> None:
        pass

    def _toc(self, value: Any) -> Any:
        return value


class Timing:
    """Adds a timer to a node for the time of a block: `with Timing(logger, "sensing"): …`"""

    def __init__(self, parent: Node, name: str) -> None:
        self.parent = parent
        self.name = name

    def __enter__(self) -> Node:
        self.section = self.parent.log_section(self.name, Timer)
        return self.section

    def __exit__(self, *_: object) -> None:
        self.section.end_collection()


def write_csv(path: Path, iterations: list[Node]) -> None:
    """Writes one row per iteration, with the number and one column per node."""
    names = [child.name for child in iterations[0].children]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["iteration", *names])
        for number, iteration in enumerate(iterations):
            writer.writerow([number, *(child.metric for child in iteration.children)])
