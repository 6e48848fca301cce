"""Cost of one timed node in a logger like that of the paper's program: prints the seconds per node of each repeat.

Usage: timer.py NODES REPEATS
"""

from __future__ import annotations

import json
import sys
import time

from peers.published_logger import Container, Timing


def main() -> None:
    nodes, repeats = map(int, sys.argv[1:])
    costs = []
    for _ in range(repeats):
        root = Container("iteration")
        begin = time.perf_counter()
        for _ in range(nodes):
            with Timing(root, "stage"):
                pass
        costs.append((time.perf_counter() - begin) / nodes)
    print(json.dumps(costs))


if __name__ == "__main__":
    main()
