"""Lag of the live figures under half the load of the ingest aim, and while a backlog is stored."""

from __future__ import annotations

import time

import store
from http_api import Api
from lag import CountTimes, poll
from deployment import Deployment, free_ports, deployment
from programs import Failure, Program
from quantiles import quantile
from report import Section, Table, rate

from . import ingest

PROBE_HZ = 50
# Load: half of the 500,000 nodes/s that the aggregator promises to store from ten agents.
LOAD_AGENTS = 10
LOAD_SPEED = 0.5
LOAD_NODES_PER_S = 250_000
# The highest rate at which one agent spools without dropping events.
FILL_HZ = 10_000
LAG_AIM_S = 0.5
CATCH_UP_AIM_NODES_PER_S = 200_000
# A backlog counts as stored when fewer events wait. The probe adds events all the time, so the
# number of waiting events need not become 0.
CAUGHT_UP_EVENTS = 1_000


def prepare() -> None:
    ingest.prepare()


def measure(quick: bool) -> Section:
    section = Section("Live figures")
    section.say(
        f"A pipeline of {PROBE_HZ} iterations a second; the live figures of the aggregator are asked for every 10 ms over "
        "HTTP. Lag: from the end of an iteration to the first answer that counts it."
    )
    table = Table("meanwhile", "iterations", "p50, ms", "p99, ms", "max, ms", "other nodes/s stored")
    for name, lags, stored in (_with_nothing_else(quick), _under_load(quick), _while_catching_up(section, quick)):
        ordered = sorted(lags)
        if not ordered:
            raise Failure(f"{name}: no iteration was seen in the live figures")
        p50, p99 = quantile(ordered, 0.5), quantile(ordered, 0.99)
        table.row(name, f"{len(ordered):,}", *(f"{1e3 * x:.0f}" for x in (p50, p99, ordered[-1])), rate(stored))
        section.aim(f"live figures, {name}: p99 ≤ {1e3 * LAG_AIM_S:.0f} ms", f"{1e3 * p99:.0f} ms", p99 <= LAG_AIM_S)
    section.table(table)
    return section


def _with_nothing_else(quick: bool) -> tuple[str, list[float], float]:
    with deployment() as daemons:
        api = _aggregator(daemons)
        lags = _probe(daemons, api, 8.0 if quick else 40.0)
    return "nothing else", lags, 0.0


def _under_load(quick: bool) -> tuple[str, list[float], float]:
    """Measures while simulated agents send at half the rate that the aggregator promises to store."""
    seconds = 8.0 if quick else 40.0
    with deployment() as daemons:
        api = _aggregator(daemons)
        # The load begins before the measurement, so it has to last longer.
        nodes = int(LOAD_NODES_PER_S * (seconds + 15.0))
        with ingest.generator(daemons.folder / "load.log", api.events, LOAD_AGENTS, nodes, LOAD_SPEED) as load:
            load.wait_until("the load is being stored", lambda: store.nodes(daemons.database) > 0)
            before, began = store.nodes(daemons.database), time.monotonic()
            lags = _probe(daemons, api, seconds)
            stored = (store.nodes(daemons.database) - before) / (time.monotonic() - began)
            load.raise_if_ended()
    return f"{rate(LOAD_NODES_PER_S)} nodes/s from {LOAD_AGENTS} agents", lags, stored


def _while_catching_up(section: Section, quick: bool) -> tuple[str, list[float], float]:
    """Measures while a backlog is stored.

    An agent fills its spool while no aggregator runs. Then an aggregator and this agent, with the probe, are started.
    """
    iterations = 60_000 if quick else 400_000
    with deployment() as daemons:
        events, web = free_ports(2)
        filling = daemons.daemon("edge", _agent(daemons, events, _filler(iterations)))
        spool = daemons.folder / "state/spool.sqlite"
        filling.wait_until("all is in the spool", lambda: store.produced(spool) >= iterations, 300.0)
        filling.stop()
        backlog = spool.stat().st_size
        api = _Api(daemons, events, web)
        began = time.monotonic()
        probe = daemons.daemon("edge", _agent(daemons, events, _pipeline()))
        count_times = CountTimes("edge", "probe")
        # One time as soon as the backlog is stored.
        caught_up_at: list[float] = []

        def note_catch_up() -> bool:
            """Notes the time if the backlog is stored; returns whether it is not yet."""
            waiting = api.waiting_events("edge")
            is_probe_counted = bool(count_times.seen) and count_times.seen[-1][1] > 0
            if waiting is not None and waiting < CAUGHT_UP_EVENTS and is_probe_counted:
                caught_up_at.append(time.monotonic())
            return not caught_up_at

        poll(api, count_times, 50.0, note_catch_up)
        if not caught_up_at:
            raise Failure(f"the backlog of {backlog / 2**20:.0f} MiB was not caught up within 50 s")
        nodes, seconds = store.nodes(daemons.database), caught_up_at[0] - began
        lags = _lags(daemons, probe, count_times)
    section.say(
        f"Catching up: {nodes:,} nodes of one agent, {backlog / 2**20:.0f} MiB on its disk, were stored in {seconds:.1f} s, "
        f"from the agent's start until fewer than {CAUGHT_UP_EVENTS:,} events waited."
    )
    stored = nodes / seconds
    promise = f"catching up ≥ {CATCH_UP_AIM_NODES_PER_S:,} nodes/s"
    section.aim(promise, rate(stored), stored >= CATCH_UP_AIM_NODES_PER_S)
    return "catching up from the agent's disk", lags, stored


class _Api(Api):
    """API client of an aggregator, with its ports."""

    def __init__(self, daemons: Deployment, events: int, web: int) -> None:
        daemons.aggregator(events=events, web=web)
        super().__init__(web)
        self.events = events


def _aggregator(daemons: Deployment) -> _Api:
    return _Api(daemons, *free_ports(2))


def _probe(daemons: Deployment, api: _Api, seconds: float) -> list[float]:
    probe = daemons.daemon("edge", _agent(daemons, api.events, _pipeline()))
    count_times = CountTimes("edge", "probe")
    poll(api, count_times, seconds)
    return _lags(daemons, probe, count_times)


def _lags(daemons: Deployment, probe: Program, count_times: CountTimes) -> list[float]:
    probe.stop()
    probe_run = store.run_of(daemons.database, "probe")
    if probe_run is None:
        raise Failure("the pipeline's run was not stored")
    return count_times.lags(store.ends(daemons.database, probe_run))


def _agent(daemons: Deployment, events: int, pipeline: str) -> str:
    return f"""
        [agent]
        name = "edge"
        state_dir = "{daemons.folder}/state"
        aggregator = "tcp://127.0.0.1:{events}"
        [[model]]
        name = "echo"
        kind = "echo"
        {pipeline}
    """


def _pipeline() -> str:
    return f"""
        [[pipeline]]
        name = "probe"
        sensor = {{ kind = "synthetic", size_bytes = 64 }}
        load = {{ mode = "rate", hz = {PROBE_HZ} }}
        placement = {{ kind = "local", model = "echo" }}
    """


def _filler(iterations: int) -> str:
    return f"""
        [[pipeline]]
        name = "filler"
        sensor = {{ kind = "synthetic", size_bytes = 64 }}
        load = {{ mode = "rate", hz = {FILL_HZ} }}
        limit = {{ iterations = {iterations} }}
        placement = {{ kind = "local", model = "echo" }}
    """
