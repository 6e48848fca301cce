"""Two hosts on one machine: network namespaces joined by a veth pair, removed after the benchmark."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from programs import Failure, Program

PREFIX = "peernet-bench-"
DEVICE = "veth0"
# Every kernel has reno, and reno does not pace. With BBR, the default of some hosts, a megabyte over a cable without
# limits takes three times as long for every program, which hides the differences between the programs.
CONGESTION_CONTROL = "reno"
# Folder in which `ip netns` keeps the named namespaces.
NAMESPACES = Path("/run/netns")


@dataclass(frozen=True)
class Host:
    """A network namespace with one interface."""

    name: str
    address: str

    def inside(self, command: Sequence[object]) -> list[str]:
        """Returns the command that runs `command` on this host."""
        return ["ip", "netns", "exec", self.name, *map(str, command)]


def need_root() -> None:
    """Raises a failure if this process has no permission to create network namespaces."""
    if os.geteuid() != 0:
        raise Failure(
            "this part makes two network namespaces, which needs root: run tests/bench/run.sh as root; "
            "only the parts loop, networks, python, stream, delays, violations and attacked need root"
        )


@contextmanager
def two_hosts() -> Iterator[tuple[Host, Host]]:
    """Yields edge and cloud, joined by a veth pair without delay or limit."""
    with _hosts() as (edge, cloud):
        _ip("link", "add", DEVICE, "netns", edge.name, "type", "veth", "peer", "name", DEVICE, "netns", cloud.name)
        for host in (edge, cloud):
            _set_up(host)
        yield edge, cloud


@contextmanager
def two_distant_hosts(
    up_ms: int, down_ms: int, bits_per_second: int | None = None
) -> Iterator[tuple[Host, Host]]:
    """Yields edge and cloud, joined by a wire with a delay per direction.

    With a rate limit, the queue of each host's interface holds 4 MB.
    """
    with _hosts() as (edge, cloud), tempfile.TemporaryDirectory(prefix=PREFIX) as folder, ExitStack() as stack:
        for host in (edge, cloud):
            switch = ["vde_switch", "--sock", f"{folder}/{host.name}", "--tap", DEVICE]
            stack.enter_context(Program(host.inside(switch), Path(folder, f"{host.name}.log"))).wait_until(
                "a virtual switch runs", lambda host=host: _has_device(host) and Path(folder, host.name, "ctl").exists()
            )
            _set_up(host)
            if bits_per_second is not None:
                shape = f"qdisc add dev {DEVICE} root tbf rate {bits_per_second}bit burst 32kb limit 4000000"
                _run(*host.inside(["tc", *shape.split()]))
        plugs = ":".join(f"{folder}/{host.name}" for host in (edge, cloud))
        wire = ["wirefilter", "-v", plugs, "-d", f"LR{up_ms}", "-d", f"RL{down_ms}", "--nofifo"]
        stack.enter_context(Program(edge.inside(wire), Path(folder, "wire.log")))
        yield edge, cloud


@contextmanager
def _hosts() -> Iterator[tuple[Host, Host]]:
    """Yields edge and cloud without a link."""
    need_root()
    _remove_abandoned()
    edge, cloud = (Host(f"{PREFIX}{os.getpid()}-{role}", f"10.77.0.{n}") for n, role in ((1, "edge"), (2, "cloud")))
    with ExitStack() as stack:
        for host in (edge, cloud):
            _ip("netns", "add", host.name)
            stack.callback(_ip, "netns", "delete", host.name)
            _ip("-n", host.name, "link", "set", "lo", "up")
        yield edge, cloud


def _set_up(host: Host) -> None:
    _ip("-n", host.name, "address", "add", f"{host.address}/24", "dev", DEVICE)
    _ip("-n", host.name, "link", "set", DEVICE, "up")
    _run(*host.inside(["sysctl", "-qw", f"net.ipv4.tcp_congestion_control={CONGESTION_CONTROL}"]))


def _has_device(host: Host) -> bool:
    command = ["ip", "-n", host.name, "link", "show", "dev", DEVICE]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@contextmanager
def third_host(cloud: Host) -> Iterator[tuple[Host, str]]:
    """Yields a third host with its own link to the cloud, and the cloud's address on this link."""
    third, second_address = Host(f"{PREFIX}{os.getpid()}-third", "10.77.1.3"), "10.77.1.2"
    with ExitStack() as stack:
        _ip("netns", "add", third.name)
        stack.callback(_ip, "netns", "delete", third.name)
        _ip("link", "add", "third", "netns", cloud.name, "type", "veth", "peer", "name", DEVICE, "netns", third.name)
        for name, device, address in ((cloud.name, "third", second_address), (third.name, DEVICE, third.address)):
            _ip("-n", name, "address", "add", f"{address}/24", "dev", device)
            _ip("-n", name, "link", "set", device, "up")
        yield third, second_address


def _remove_abandoned() -> None:
    """Removes the namespaces of killed benchmarks: their names contain a process id that does not exist any more."""
    for leftover in NAMESPACES.glob(f"{PREFIX}*"):
        pid = leftover.name.removeprefix(PREFIX).split("-")[0]
        if pid.isdecimal() and not Path("/proc", pid).exists():
            _ip("netns", "delete", leftover.name)


def _ip(*arguments: str) -> None:
    _run("ip", *arguments)


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise Failure(f"{' '.join(command)} failed: {done.stderr.strip()}")
