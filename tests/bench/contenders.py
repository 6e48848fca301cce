"""The closed loop over two hosts as three programs do it: PEERNet, the published program's work, bare TCP."""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import store
from namespaces import Host
from plant import Plant, plant
from programs import BARE_TCP, Failure, Program, output, peer

DATA_PORT = 5551
TCP_PORT = 5560
# Caches fill, connections open up; the other two programs have the same number built in.
WARM_UP = 200
# Letters of /proc/net/tcp.
ESTABLISHED, LISTENING = "01", "0A"

Stages = dict[str, dict[str, float]]


@dataclass(frozen=True)
class Shape:
    """What travels: so many bytes up, and as many or a fixed number down."""

    up: int
    answer: int | None = None

    @property
    def down(self) -> int:
        return self.up if self.answer is None else self.answer


@dataclass(frozen=True)
class Slice:
    """One contender's figures of a few seconds; stages in seconds."""

    rate: float
    stages: Stages
    missing: int = 0


@dataclass(frozen=True)
class Arena:
    """Where a slice takes place, and how long it lasts."""

    edge: Host
    cloud: Host
    seconds: int


def peernet(arena: Arena, shape: Shape) -> Slice:
    """Edge agent, cloud agent, and the aggregator beside the edge: every iteration is stored while the loop runs."""
    with plant() as it:
        it.aggregator(arena.edge)
        reporting = f'aggregator = "tcp://{arena.edge.address}:5550"'
        it.daemon("cloud", _cloud(it, arena, shape, reporting), arena.cloud)
        edge = it.daemon("edge", _edge(it, arena, shape, reporting, f"duration_s = {arena.seconds}.0"), arena.edge)
        edge.wait_until("the run is stored", lambda: it.is_stored("loop"), arena.seconds + 60)
        it.stop()
        run = store.run_of(it.database, "loop")
        if run is None or run.unsuccessful or not run.ok:
            raise Failure(f"the loop of {shape} did not go well: {run}; the edge said:\n{edge.text()}")
        return Slice(
            store.iterations_per_second(it.database, run), store.stages(it.database, run), store.missing(it.database)
        )


def peernet_alone(arena: Arena, shape: Shape, iterations: int) -> float:
    """Iterations per second of both agents without an aggregator, over the life of their connection."""
    with plant() as it:
        it.daemon("cloud", _cloud(it, arena, shape, ""), arena.cloud)
        edge = it.daemon("edge", _edge(it, arena, shape, "", f"iterations = {iterations}"), arena.edge)
        # The daemon may be connected already: its being ready is not far from that.
        edge.wait_until("the edge is connected", lambda: _sees(edge, DATA_PORT, ESTABLISHED))
        begin = time.perf_counter()
        while _sees(edge, DATA_PORT, ESTABLISHED):
            if time.perf_counter() - begin > 10 * arena.seconds + 60:
                raise Failure(f"{iterations} iterations of {shape} did not come to their end")
            time.sleep(0.002)
        return (iterations + WARM_UP) / (time.perf_counter() - begin)


def published(arena: Arena, shape: Shape) -> Slice:
    """The Python program of peers/published.py."""
    answer = [] if shape.answer is None else ["--answer-bytes", shape.answer]
    ends = arena.cloud.address, arena.edge.address
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder:
        server = arena.cloud.inside(peer("published", "server", *ends, *answer))
        client = peer("published", "client", *reversed(ends), "--bytes", shape.up)
        client += ["--seconds", str(arena.seconds), "--results", f"{folder}/data.csv"]
        with Program(server, Path(folder, "server.log")):
            return _slice(output(arena.edge.inside(client), timeout_s=arena.seconds + 60))


def bare_tcp(arena: Arena, shape: Shape) -> Slice:
    """The Rust program of peers/bare_tcp.rs."""
    address = f"{arena.cloud.address}:{TCP_PORT}"
    serve = arena.cloud.inside([BARE_TCP, "serve", address])
    drive = arena.edge.inside([BARE_TCP, "drive", address, shape.up, shape.down, arena.seconds])
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder, Program(serve, Path(folder, "log")) as server:
        server.wait_until("bare-tcp listens", lambda: _sees(server, TCP_PORT, LISTENING))
        return _slice(output(drive, timeout_s=arena.seconds + 60))


def _slice(text: str) -> Slice:
    figures = json.loads(text)
    return Slice(figures["iterations"] / figures["seconds"], figures["stages"])


def _cloud(it: Plant, arena: Arena, shape: Shape, reporting: str) -> str:
    return f"""
        [agent]
        name = "cloud"
        state_dir = "{it.folder}/cloud"
        {reporting}
        [serve]
        listen = "tcp://{arena.cloud.address}:{DATA_PORT}"
        [[model]]
        name = "echo"
        kind = "echo"
        {"" if shape.answer is None else f"answer_bytes = {shape.answer}"}
    """


def _edge(it: Plant, arena: Arena, shape: Shape, reporting: str, limit: str) -> str:
    return f"""
        [agent]
        name = "edge"
        state_dir = "{it.folder}/edge"
        {reporting}
        [[pipeline]]
        name = "loop"
        sensor = {{ kind = "synthetic", size_bytes = {shape.up} }}
        placement = {{ kind = "remote", peer = "tcp://{arena.cloud.address}:{DATA_PORT}", model = "echo" }}
        load = {{ mode = "closed" }}
        warm_up = {{ iterations = {WARM_UP} }}
        limit = {{ {limit} }}
    """


def _sees(program: Program, port: int, state: str) -> bool:
    """Whether the program's host has a TCP socket in this state with this port at either end."""
    for line in Path(f"/proc/{program.pid}/net/tcp").read_text().splitlines()[1:]:
        _, local, remote, found = line.split()[:4]
        if found == state and f":{port:04X}" in (local[8:], remote[8:]):
            return True
    return False
