"""The same echo over every network of PEERNet, over bare transports, and between nodes of ROS."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import contenders
from contenders import Arena, Shape, Slice
from namespaces import Host
from programs import BARE_DDS, ROOT, ROSLIBRUST_PEER, Failure, Program, output_and_cpu

UDP_PORT = 5552
MASTER_PORT = 11311
ROSPY_PEER = ROOT / "tests/interop/ros1/rospy_peer.py"

# Assumed speed of rospy, which gives the number of its round trips in a slice. Bytes of both directions together.
ROSPY_BYTES_PER_SECOND = 100e6
ROSPY_ROUND_TRIPS_PER_SECOND = 500


class Shared:
    """What all contenders share: a master of ROS 1 on the cloud."""

    def __init__(self, edge: Host, cloud: Host) -> None:
        self._hosts = (edge, cloud)
        self._stack = ExitStack()
        self.master = f"{cloud.address}:{MASTER_PORT}"

    def __enter__(self) -> Self:
        _, cloud = self._hosts
        folder = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="peernet-bench-"))
        command = ["rosmaster", "--core", "-p", str(MASTER_PORT)]
        log = Path(folder, "rosmaster.log")
        master = Program(cloud.inside(command), log, environment=self.environment(cloud))
        self._stack.enter_context(master).wait_until(
            "the master of ROS listens", lambda: contenders.sees(master, MASTER_PORT, contenders.LISTENING)
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def environment(self, host: Host) -> Mapping[str, str]:
        """The environment of a node of ROS on a host."""
        return {**os.environ, "ROS_MASTER_URI": f"http://{self.master}", "ROS_IP": host.address}


def prepare() -> None:
    needed = {"rospy": "/usr/lib/python3/dist-packages/rospy", "OpenSSL for roslibrust": "/usr/include/openssl"}
    for name, folder in needed.items():
        if not Path(folder).is_dir():
            raise Failure(f"{name} is not installed; install it with deploy/install-tools.sh interop")


def _rospy(arena: Arena, shared: Shared, shape: Shape) -> Slice:
    """Two rospy nodes, of which one sends back what it gets."""
    count = max(10, int(arena.seconds * min(ROSPY_ROUND_TRIPS_PER_SECOND, ROSPY_BYTES_PER_SECOND / (2 * shape.up))))
    interpreter = "/usr/bin/python3"
    echo = arena.cloud.inside([interpreter, ROSPY_PEER, "echo", "echo", "/up", "/down"])
    ping = arena.edge.inside([interpreter, ROSPY_PEER, "ping", "ping", "/up", "/down", count, shape.up])
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder:
        log = Path(folder, "echo.log")
        with Program(echo, log, environment=shared.environment(arena.cloud)) as node:
            node.wait_until("the node is ready", lambda: "ready" in node.text())
            before = node.cpu_seconds()
            text, cpu_seconds = output_and_cpu(ping, environment=shared.environment(arena.edge))
            # "median 312 p99 502 rate 2500", microseconds
            words = text.split()
            median, p99, rate = (float(words[words.index(word) + 1]) for word in ("median", "p99", "rate"))
            spread = {"count": count, "p50": median * 1e-6, "p99": p99 * 1e-6}
            return Slice(rate, {"total": spread}, count, count, cpu_seconds + node.cpu_seconds() - before)


def _roslibrust(arena: Arena, shared: Shared, shape: Shape) -> Slice:
    """Two nodes of roslibrust, of which one sends back what it gets."""
    environments = shared.environment(arena.edge), shared.environment(arena.cloud)
    return contenders.bare_pair(arena, shape, ROSLIBRUST_PEER, environments)


CONTENDERS: dict[str, Callable[[Arena, Shared, Shape], Slice]] = {
    "zmq-tcp": lambda arena, _, shape: contenders.peernet(arena, shape),
    "zmq-udp": lambda arena, _, shape: contenders.peernet(arena, shape, f"udp://{arena.cloud.address}:{UDP_PORT}"),
    "ros1": lambda arena, shared, shape: contenders.peernet(arena, shape, f"ros1://{shared.master}/cloud"),
    "bare TCP": lambda arena, _, shape: contenders.bare_tcp(arena, shape),
    "bare UDP": lambda arena, _, shape: contenders.bare_udp(arena, shape),
    "rospy": _rospy,
    "roslibrust": _roslibrust,
    "ros2": lambda arena, _, shape: contenders.peernet(arena, shape, "ros2://0/cloud"),
    "rustdds": lambda arena, _, shape: contenders.bare_pair(arena, shape, BARE_DDS),
}
