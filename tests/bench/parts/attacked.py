"""p99 of a running pipeline while an unknown host sends garbage to every port."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from statistics import median

import store
from namespaces import Host, need_root, third_host, two_hosts
from deployment import Deployment, deployment
from programs import Failure, Program, output
from quantiles import spread
from report import Section, Table, micros, ratio, times

AIM = 1.2
HZ = 100
SIZE = 150_000
BYTES_PER_SECOND = 2_000_000
# Time after which an attacking connection is replaced; longer than PEERNet waits for a hello.
LIFETIME_S = 6
# The ports of PEERNet, and those of a process that reads and discards.
PORTS = {"events": 5550, "data": 5551, "udp-data": 5552, "http": 8040, "probes": 8620}
DISCARD_PORTS = {name: port + 10_000 for name, port in PORTS.items()}
ATTACK = Path(__file__).parent.parent / "peers/attack.py"


def prepare() -> None:
    need_root()


def measure(quick: bool) -> Section:
    seconds, repeats = (5, 1) if quick else (30, 5)
    section = Section("Beside an unknown host")
    section.say(
        f"Edge and cloud in two network namespaces, aggregator and dashboard beside the cloud; {SIZE // 1000} kB at "
        f"{HZ} Hz, echoed, stored. A third host on a cable of its own to the cloud sends garbage, silence, false sizes "
        f"and unfinished frames, {BYTES_PER_SECOND / 1e6:g} MB/s in all and 60 connections of each kind, each replaced "
        f"after {LIFETIME_S} s: to every port of PEERNet, or at the same rate to a process on the cloud that reads and "
        f"discards it. {repeats} repeats of {seconds} s in turn; medians, ratios repeat by repeat."
    )
    totals: dict[str, list[dict[str, float]]] = {"discarded": [], "attacked": []}
    peaks: list[float] = []
    with two_hosts() as (edge, cloud), third_host(cloud) as (third, target):
        for repeat in range(repeats):
            for name in list(totals) if repeat % 2 == 0 else reversed(list(totals)):
                total, peak = _slice(edge, cloud, third, target, name, seconds)
                totals[name].append(total)
                if name == "attacked":
                    peaks.append(peak)
            print(f"  repeat {repeat + 1} of {repeats}", file=sys.stderr, flush=True)
    table = Table("total, µs", "p50", "p99")
    for name, slices in totals.items():
        table.row(name, *(micros(median(one[q] for one in slices)) for q in ("p50", "p99")))
    section.table(table)
    p99 = {name: [one["p99"] for one in slices] for name, slices in totals.items()}
    gain = ratio(p99["attacked"], p99["discarded"])
    section.aim(f"p99 beside an unknown host: ≤ {AIM:g} × the same traffic discarded", times(gain), gain <= AIM)
    section.say(f"Peak memory of the larger of the two daemons on the cloud: {max(peaks) / 2**20:.0f} MiB.")
    return section


def _slice(
    edge: Host, cloud: Host, third: Host, target: str, name: str, seconds: int
) -> tuple[dict[str, float], float]:
    """Measures once with new daemons. Returns the spread of `total`, and the peak memory of the larger daemon, bytes."""
    with deployment() as daemons:
        aggregator = daemons.daemon("aggregator", _aggregator(daemons), cloud)
        agent = daemons.daemon("cloud", _cloud(daemons, cloud), cloud)
        edge_agent = daemons.daemon("edge", _edge(daemons, cloud, seconds), edge)
        edge_agent.wait_until("the pipeline is stored", lambda: store.run_of(daemons.database, "loop") is not None)
        ports = PORTS if name == "attacked" else DISCARD_PORTS
        with _discarding(daemons, cloud, target) if name == "discarded" else nullcontext():
            attack = [sys.executable, "-B", ATTACK, "attack", target, *_flags(ports), "--seconds", seconds]
            attack += ["--bytes-per-second", BYTES_PER_SECOND, "--life", LIFETIME_S]
            counts = json.loads(output(third.inside(attack), timeout_s=seconds + 60))
        edge_agent.wait_until("the run is stored", lambda: daemons.is_stored("loop"), seconds + 60)
        peak = max(_peak_memory(program.pid) for program in (aggregator, agent))
        daemons.stop()
        run = store.run_of(daemons.database, "loop")
        if run is None or run.unsuccessful or not run.ok or store.missing(daemons.database):
            raise Failure(f"the loop did not go well ({name}, {counts}): {run}; the edge said:\n{edge_agent.text()}")
        return spread(store.samples(daemons.database, run, ("total",))["total"]), peak


@contextmanager
def _discarding(daemons: Deployment, cloud: Host, target: str) -> Iterator[None]:
    """Runs the process on the cloud that reads the attack and discards it."""
    command = cloud.inside([sys.executable, "-B", ATTACK, "discard", target, *_flags(DISCARD_PORTS)])
    with Program(command, daemons.folder / "discard.log") as discard:
        discard.wait_until("it discards", lambda: "discarding" in discard.text())
        yield


def _flags(ports: dict[str, int]) -> list[object]:
    return [part for name, port in ports.items() for part in (f"--{name}", port)]


def _peak_memory(pid: int) -> int:
    status = Path(f"/proc/{pid}/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024


def _aggregator(daemons: Deployment) -> str:
    return f"""
        [aggregator]
        name = "aggregator"
        listen = "tcp://0.0.0.0:{PORTS["events"]}"
        database = "{daemons.database}"
        [web]
        listen = "0.0.0.0:{PORTS["http"]}"
        allow_unauthenticated = true
    """


def _cloud(daemons: Deployment, cloud: Host) -> str:
    return f"""
        [agent]
        name = "cloud"
        state_dir = "{daemons.folder}/cloud"
        aggregator = "tcp://{cloud.address}:{PORTS["events"]}"
        [serve]
        listen = ["tcp://0.0.0.0:{PORTS["data"]}", "udp://0.0.0.0:{PORTS["udp-data"]}"]
        [[model]]
        name = "echo"
        kind = "echo"
    """


def _edge(daemons: Deployment, cloud: Host, seconds: int) -> str:
    return f"""
        [agent]
        name = "edge"
        state_dir = "{daemons.folder}/edge"
        aggregator = "tcp://{cloud.address}:{PORTS["events"]}"
        [[pipeline]]
        name = "loop"
        sensor = {{ kind = "synthetic", size_bytes = {SIZE} }}
        placement = {{ kind = "remote", peer = "tcp://{cloud.address}:{PORTS["data"]}", model = "echo" }}
        load = {{ mode = "rate", hz = {HZ}.0 }}
        warm_up = {{ iterations = {HZ} }}
        limit = {{ duration_s = {seconds}.0 }}
    """
