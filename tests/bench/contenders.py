"""The closed loop over two hosts by several programs: PEERNet, a Python program that does the same work as the paper's
program, and Rust programs that use bare TCP or bare UDP."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import store
from namespaces import Host
from deployment import Deployment, deployment
from programs import BARE_TCP, BARE_UDP, Failure, Program, output_and_cpu, peer

DATA_PORT = 5551
BARE_PORT = 5560
# What zmq-udp sends by default.
DATAGRAM_BYTES = 1_200
# Iterations in which caches fill and TCP windows open. The programs of peers/ have the same number built in.
WARM_UP = 200
# Codes of a socket's state in /proc/net/tcp and /proc/net/udp.
ESTABLISHED, LISTENING, BOUND = "01", "0A", "07"

Stages = dict[str, dict[str, float]]


@dataclass(frozen=True)
class Shape:
    """Sizes of the messages: bytes up, and the same or a fixed number of bytes down."""

    up: int
    answer: int | None = None

    @property
    def down(self) -> int:
        return self.up if self.answer is None else self.answer


@dataclass(frozen=True)
class Slice:
    """Figures of one program over a few seconds; stages in seconds."""

    rate: float
    stages: Stages
    # Messages sent and answered.
    sent: int
    answered: int
    # Processor time of both ends.
    cpu_seconds: float
    # Events that the database lacks; 0 for programs without a database.
    missing: int = 0


@dataclass(frozen=True)
class Arena:
    """Hosts and duration of a slice."""

    edge: Host
    cloud: Host
    seconds: int
    # Number of warm-up iterations.
    warm_up: int = WARM_UP


def peernet(arena: Arena, shape: Shape, peer: str | None = None) -> Slice:
    """Runs edge agent, cloud agent, and the aggregator on the edge's host: every iteration is stored while the loop runs.

    `peer` is the cloud's address with its network; without it, the network is TCP.
    """
    with deployment() as daemons:
        daemons.aggregator(arena.edge)
        reporting = f'aggregator = "tcp://{arena.edge.address}:5550"'
        cloud = daemons.daemon("cloud", _cloud(daemons, arena, shape, reporting, peer), arena.cloud)
        limit = f"duration_s = {arena.seconds}.0"
        edge = daemons.daemon("edge", _edge(daemons, arena, shape, reporting, limit, peer), arena.edge)
        edge.wait_until("the run is stored", lambda: daemons.is_stored("loop"), arena.seconds + 60)
        cpu_seconds = edge.cpu_seconds() + cloud.cpu_seconds()
        daemons.stop()
        run = store.run_of(daemons.database, "loop")
        may_lose = peer is not None and peer.startswith(("udp://", "ros2://"))
        if run is None or not run.ok or (run.unsuccessful and not may_lose):
            raise Failure(f"the loop of {shape} did not go well: {run}; the edge said:\n{edge.text()}")
        return Slice(
            store.iterations_per_second(daemons.database, run),
            store.stages(daemons.database, run),
            run.ok + run.unsuccessful,
            run.ok,
            cpu_seconds,
            store.missing(daemons.database),
        )


def peernet_alone(arena: Arena, shape: Shape, iterations: int) -> float:
    """Returns the iterations per second of both agents without an aggregator, over the life of their connection."""
    with deployment() as daemons:
        daemons.daemon("cloud", _cloud(daemons, arena, shape, ""), arena.cloud)
        edge = daemons.daemon("edge", _edge(daemons, arena, shape, "", f"iterations = {iterations}"), arena.edge)
        # The daemon may be connected before it reports ready; the difference is small.
        edge.wait_until("the edge is connected", lambda: sees(edge, DATA_PORT, ESTABLISHED))
        begin = time.perf_counter()
        while sees(edge, DATA_PORT, ESTABLISHED):
            if time.perf_counter() - begin > 10 * arena.seconds + 60:
                raise Failure(f"{iterations} iterations of {shape} did not come to their end")
            time.sleep(0.002)
        return (iterations + arena.warm_up) / (time.perf_counter() - begin)


def published(arena: Arena, shape: Shape) -> Slice:
    """Runs the Python program of peers/published.py."""
    answer = [] if shape.answer is None else ["--answer-bytes", shape.answer]
    # Each end takes its own address, then the address of the other end.
    ends = arena.cloud.address, arena.edge.address
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder:
        server = arena.cloud.inside(peer("published", "server", *ends, *answer))
        client = peer("published", "client", *reversed(ends), "--bytes", shape.up)
        client += ["--seconds", str(arena.seconds), "--results", f"{folder}/data.csv"]
        with Program(server, Path(folder, "server.log")) as server:
            return _slice(arena.edge.inside(client), server)


def bare_tcp(arena: Arena, shape: Shape) -> Slice:
    """Runs the Rust program of peers/bare_tcp.rs."""
    return _bare(arena, shape, BARE_TCP, "tcp", LISTENING)


def bare_udp(arena: Arena, shape: Shape) -> Slice:
    """Runs the Rust program of peers/bare_udp.rs."""
    return _bare(arena, shape, BARE_UDP, "udp", BOUND, DATAGRAM_BYTES)


def _bare(arena: Arena, shape: Shape, program: Path, protocol: str, state: str, *options: object) -> Slice:
    address = f"{arena.cloud.address}:{BARE_PORT}"
    serve = arena.cloud.inside([program, "serve", address, *options])
    drive = arena.edge.inside([program, "drive", address, *options, shape.up, shape.down, arena.seconds])
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder, Program(serve, Path(folder, "log")) as server:
        server.wait_until("it listens", lambda: sees(server, BARE_PORT, state, protocol))
        return _slice(drive, server, arena.seconds + 60)


def bare_pair(
    arena: Arena, shape: Shape, program: Path, environments: tuple[Mapping[str, str], Mapping[str, str]] | None = None
) -> Slice:
    """Runs `PROGRAM serve` on the cloud, and `PROGRAM drive BYTES SECONDS` on the edge, which connects to it."""
    on_edge, on_cloud = environments or (None, None)
    serve = arena.cloud.inside([program, "serve"])
    drive = arena.edge.inside([program, "drive", shape.up, arena.seconds])
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder:
        with Program(serve, Path(folder, "log"), environment=on_cloud) as server:
            return _slice(drive, server, arena.seconds + 60, on_edge)


def _slice(
    drive: Sequence[object], server: Program, timeout_s: float = 120.0, environment: Mapping[str, str] | None = None
) -> Slice:
    """Runs the driving end until it finishes, while the other end runs."""
    before = server.cpu_seconds()
    text, cpu_seconds = output_and_cpu(drive, timeout_s=timeout_s, environment=environment)
    figures = json.loads(text)
    answered = figures["iterations"]
    return Slice(
        answered / figures["seconds"],
        figures["stages"],
        answered + figures.get("lost", 0),
        answered,
        cpu_seconds + server.cpu_seconds() - before,
    )


def _cloud(daemons: Deployment, arena: Arena, shape: Shape, reporting: str, peer: str | None = None) -> str:
    return f"""
        [agent]
        name = "cloud"
        state_dir = "{daemons.folder}/cloud"
        {reporting}
        [serve]
        listen = "{peer or _tcp(arena)}"
        [[model]]
        name = "echo"
        kind = "echo"
        {"" if shape.answer is None else f"answer_bytes = {shape.answer}"}
    """


def _edge(daemons: Deployment, arena: Arena, shape: Shape, reporting: str, limit: str, peer: str | None = None) -> str:
    return f"""
        [agent]
        name = "edge"
        state_dir = "{daemons.folder}/edge"
        {reporting}
        [[pipeline]]
        name = "loop"
        sensor = {{ kind = "synthetic", size_bytes = {shape.up} }}
        placement = {{ kind = "remote", peer = "{peer or _tcp(arena)}", model = "echo" }}
        load = {{ mode = "closed" }}
        warm_up = {{ iterations = {arena.warm_up} }}
        limit = {{ {limit} }}
    """


def _tcp(arena: Arena) -> str:
    return f"tcp://{arena.cloud.address}:{DATA_PORT}"


def sees(program: Program, port: int, state: str, protocol: str = "tcp") -> bool:
    """Returns whether the program's host has a socket in this state with this port at either end."""
    for line in Path(f"/proc/{program.pid}/net/{protocol}").read_text().splitlines()[1:]:
        _, local, remote, found = line.split()[:4]
        if found == state and f":{port:04X}" in (local[8:], remote[8:]):
            return True
    return False
