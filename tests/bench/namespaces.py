"""Two hosts on one machine: network namespaces joined by a veth pair, gone when the benchmark is."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from programs import Failure

PREFIX = "peernet-bench-"
# Every kernel has it and it does not pace: with BBR, the default of some hosts, a megabyte over a cable without limits
# takes three times as long, whatever program sends it, and the differences between programs drown in that.
CONGESTION_CONTROL = "reno"
MADE_BY_IP = Path("/run/netns")


@dataclass(frozen=True)
class Host:
    """A network namespace with one interface."""

    name: str
    address: str

    def inside(self, command: Sequence[object]) -> list[str]:
        """The command that runs `command` on this host."""
        return ["ip", "netns", "exec", self.name, *map(str, command)]


def need_root() -> None:
    """Fails when this process may not make network namespaces."""
    if os.geteuid() != 0:
        raise Failure(
            "the part 'loop' makes two network namespaces, which needs root: run tests/bench/run.sh loop as root; "
            "the other parts (node, model, ingest, idle) need none"
        )


@contextmanager
def two_hosts() -> Iterator[tuple[Host, Host]]:
    """Edge and cloud, joined by a cable without delay or limit."""
    need_root()
    _sweep()
    edge, cloud = (Host(f"{PREFIX}{os.getpid()}-{role}", f"10.77.0.{n}") for n, role in ((1, "edge"), (2, "cloud")))
    with ExitStack() as stack:
        for host in (edge, cloud):
            _ip("netns", "add", host.name)
            stack.callback(_ip, "netns", "delete", host.name)
        _ip("link", "add", "veth0", "netns", edge.name, "type", "veth", "peer", "name", "veth0", "netns", cloud.name)
        for host in (edge, cloud):
            _ip("-n", host.name, "address", "add", f"{host.address}/24", "dev", "veth0")
            _ip("-n", host.name, "link", "set", "lo", "up")
            _ip("-n", host.name, "link", "set", "veth0", "up")
            _run(*host.inside(["sysctl", "-qw", f"net.ipv4.tcp_congestion_control={CONGESTION_CONTROL}"]))
        yield edge, cloud


@contextmanager
def third_host(cloud: Host) -> Iterator[tuple[Host, str]]:
    """A third host on a cable of its own to the cloud, and the address at which it reaches the cloud."""
    third, faces = Host(f"{PREFIX}{os.getpid()}-third", "10.77.1.3"), "10.77.1.2"
    with ExitStack() as stack:
        _ip("netns", "add", third.name)
        stack.callback(_ip, "netns", "delete", third.name)
        _ip("link", "add", "third", "netns", cloud.name, "type", "veth", "peer", "name", "veth0", "netns", third.name)
        for name, device, address in ((cloud.name, "third", faces), (third.name, "veth0", third.address)):
            _ip("-n", name, "address", "add", f"{address}/24", "dev", device)
            _ip("-n", name, "link", "set", device, "up")
        yield third, faces


def _sweep() -> None:
    """Removes what a killed benchmark left behind: namespaces named after a process that is no more."""
    for leftover in MADE_BY_IP.glob(f"{PREFIX}*"):
        pid = leftover.name.removeprefix(PREFIX).split("-")[0]
        if pid.isdecimal() and not Path("/proc", pid).exists():
            _ip("netns", "delete", leftover.name)


def _ip(*arguments: str) -> None:
    _run("ip", *arguments)


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise Failure(f"{' '.join(command)} failed: {done.stderr.strip()}")
