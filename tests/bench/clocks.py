"""Two agents that read the clocks of one kernel, with artificial errors of the edge's clocks.

The artificial errors are known. The true delays therefore follow from the stored stamps, and are compared with the
stored delays.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from statistics import fmean

import others
import store
from namespaces import Host, two_distant_hosts, two_hosts
from deployment import LOOPBACK, Deployment, free_ports, deployment
from programs import Failure, Program, output
from quantiles import quantile

DIRECTIONS = ("upload", "download")
HZ = 100
# The edge's clocks are ahead of the cloud's by this time.
AHEAD_S = 0.5
# Begin in seconds after the start, length in seconds, and rate in ppm of each slew. A kernel slews at 500 ppm, and
# chrony at 40,000 ppm.
SLEWS = ((3.0, 4.0, 500.0), (8.0, 1.0, 40_000.0))
SLEW_HZ = 10
# Values are stored in seconds with 53 bits, and undoing a drift rounds.
ROUNDING_S = 4e-9
# Verdicts whose interval is promised to contain the truth.
BELIEVED = ("ok", "limited")


@dataclass(frozen=True)
class Path:
    """The network path between edge and cloud."""

    name: str
    # Delays of the two directions: up, down.
    delays_ms: tuple[int, int] = (0, 0)

    @contextmanager
    def hosts(self) -> Iterator[tuple[Host, Host]]:
        """Yields the two ends of the path: edge, cloud."""
        if self == LOOP:
            yield LOOPBACK, LOOPBACK
        elif self == VETH:
            with two_hosts() as hosts:
                yield hosts
        else:
            with two_distant_hosts(*self.delays_ms) as hosts:
                yield hosts


LOOP = Path("loopback")
VETH = Path("veth")


def wire(up_ms: int, down_ms: int) -> Path:
    """Returns a path with these delays."""
    return Path(f"{up_ms}/{down_ms} ms", (up_ms, down_ms))


def slews() -> tuple[tuple[float, float], ...]:
    """Returns many small steps in place of the slews: time after the start and size of each step, in seconds."""
    return tuple(
        (begin + number / SLEW_HZ, ppm * 1e-6 / SLEW_HZ)
        for begin, lasts, ppm in SLEWS
        for number in range(round(lasts * SLEW_HZ))
    )


@dataclass(frozen=True)
class Clocks:
    """How the edge's clocks are wrong, and what the estimate of the offset assumes."""

    drift_ppm: float = 0.0
    ahead_s: float = AHEAD_S
    # Steps of the wall clock and of the free-running clock: time after the start and size of each step, in seconds.
    wall_steps: tuple[tuple[float, float], ...] = ()
    raw_steps: tuple[tuple[float, float], ...] = ()
    # Claim of the edge about its wall clock, as in [clock_fault].
    discipline: str = "none"
    # Lines of [clock] on both hosts.
    settings: str = "discipline = []"

    def clock_fault(self) -> str:
        """Returns the table [clock_fault] that causes these errors of the edge's clocks."""
        steps = [(at, by, "wall") for at, by in self.wall_steps] + [(at, by, "raw") for at, by in self.raw_steps]
        text = ", ".join(f'{{ at_s = {at}, by_ms = {by * 1e3}, clock = "{clock}" }}' for at, by, clock in steps)
        return f"""
        [clock_fault]
        offset_ms = {self.ahead_s * 1e3}
        drift_ppm = {self.drift_ppm}
        discipline = "{self.discipline}"
        steps = [{text}]
        """

    def true_ns(self, shown: int) -> int:
        """Returns the time on the kernel's free-running clock at which the edge's free-running clock showed `shown`.

        Both times count from the start of the fault injection.
        """
        steps = sorted(self.raw_steps)
        for passed in range(len(steps), -1, -1):
            stepped = sum(by for _, by in steps[:passed])
            elapsed = shown - round((self.ahead_s + stepped) * 1e9)
            truth = elapsed - round(elapsed - elapsed / (1 + self.drift_ppm * 1e-6))
            if passed == 0 or truth >= steps[passed - 1][0] * 1e9:
                return truth
        raise AssertionError("the case without a passed step always returns")


@dataclass(frozen=True)
class JudgedDelay:
    """A reported delay and the true delay. All values in seconds; `at` is the time since the start of the edge."""

    at: float
    verdict: str
    value: float | None
    bounds: tuple[float, float] | None
    truth: float

    @property
    def is_believed(self) -> bool:
        return self.verdict in BELIEVED

    @property
    def is_outside(self) -> bool:
        """Whether the delay's interval is believed and does not contain the true delay."""
        if self.bounds is None or not self.is_believed:
            return False
        return self.excess > ROUNDING_S

    @property
    def excess(self) -> float:
        """How far the true delay is outside the delay's interval; negative inside."""
        lo, hi = self.bounds or (self.truth, self.truth)
        return max(lo - self.truth, self.truth - hi)


@dataclass(frozen=True)
class Errors:
    """Errors of the believed delays of one direction, in seconds."""

    # Number of all delays, of believed delays, and of believed delays whose interval does not contain the true delay.
    count: int
    believed: int
    outside: int
    # Median of the true delays.
    truth: float
    # Mean and 99th percentile of the errors without their sign.
    mean: float
    p99: float
    # Median width of the intervals.
    width: float

    @classmethod
    def of(cls, delays: list[JudgedDelay]) -> Errors:
        believed = [one for one in delays if one.is_believed and one.value is not None and one.bounds is not None]
        if not believed:
            raise Failure(f"none of {len(delays)} delays has a value that is believed")
        errors = sorted(abs(one.value - one.truth) for one in believed)
        return cls(
            len(delays),
            len(believed),
            sum(one.is_outside for one in believed),
            quantile(sorted(one.truth for one in believed), 0.5),
            fmean(errors),
            quantile(errors, 0.99),
            quantile(sorted(one.bounds[1] - one.bounds[0] for one in believed), 0.5),
        )


@dataclass(frozen=True)
class Scene:
    """A pipeline of 1 kB over a path for some seconds."""

    clocks: Clocks
    seconds: float
    timestamps: str = "kernel"
    # A second pipeline fills the path.
    saturated: bool = False
    # If given, libfaketime shows the cloud a time that is ahead by this many seconds. The edge's clocks are then right,
    # and both agents state the same boot id.
    false_time_s: float | None = None

    def run(self, edge: Host, cloud: Host) -> dict[str, list[JudgedDelay]]:
        """Measures, and returns the delays of both directions, without the delays of the warm-up."""
        with deployment() as daemons:
            events, web, data = free_ports(3)
            daemons.aggregator(edge, events=events, web=web)
            environment = {} if self.false_time_s is None else others.false_time(self.false_time_s, every_clock=True)
            daemons.daemon("cloud", self._cloud(daemons, cloud, data), cloud, environment)
            wall_minus_raw_ns = _wall_minus_raw_ns()
            text = self._edge(daemons, f"{edge.address}:{events}", f"{cloud.address}:{data}")
            agent = daemons.daemon("edge", text, edge)
            # Under libfaketime, the cloud's free-running clock shows the time of the wall clock, so the stamps of the
            # wall clocks are compared. Otherwise the stamps are those of the free-running clocks, and the start of the
            # fault injection is converted to the free-running clock.
            wall = self.false_time_s is not None
            since_ns = time.time_ns() if wall else _since_ns(agent, edge, web) - wall_minus_raw_ns
            agent.wait_until("its run is stored", lambda: daemons.is_stored("small"), self.seconds + 60)
            run = store.run_of(daemons.database, "small")
            if run is None:
                raise Failure("the run that was stored is gone")
            database = daemons.database
            rows = {direction: store.delays(database, run, direction, wall=wall) for direction in DIRECTIONS}
            return {direction: self._judged(delays, since_ns, direction) for direction, delays in rows.items()}

    def _judged(self, rows: list[store.Delay], since_ns: int, direction: str) -> list[JudgedDelay]:
        judged = []
        for row in rows:
            bounds = None if row.lo is None or row.hi is None else (row.lo, row.hi)
            if direction == "upload":
                edge, cloud = self._edge_ns(row.sent_ns - since_ns), self._cloud_ns(row.received_ns - since_ns)
                truth = cloud - edge
            else:
                edge, cloud = self._edge_ns(row.received_ns - since_ns), self._cloud_ns(row.sent_ns - since_ns)
                truth = edge - cloud
            judged.append(JudgedDelay(edge * 1e-9, row.verdict, row.value, bounds, truth * 1e-9))
        return judged

    def _edge_ns(self, shown: int) -> int:
        return shown if self.false_time_s is not None else self.clocks.true_ns(shown)

    def _cloud_ns(self, shown: int) -> int:
        return shown - round((self.false_time_s or 0.0) * 1e9)

    def _agent(self, daemons: Deployment, name: str, more: str) -> str:
        # With equal clock identities, the agents could find that they read one clock. With libfaketime, both agents
        # keep the boot id of the machine as their identity, because two clocks with one boot id are to be measured.
        return f"""
        [agent]
        name = "{name}"
        state_dir = "{daemons.folder}/{name}"
        {"" if self.false_time_s is not None else f'clock_identity = "{name}"'}
        {more}
        [clock]
        timestamps = "{self.timestamps}"
        {self.clocks.settings}
        """

    def _cloud(self, daemons: Deployment, host: Host, data: int) -> str:
        return f"""
        {self._agent(daemons, "cloud", "")}
        [serve]
        listen = "tcp://{host.address}:{data}"
        [[model]]
        name = "echo"
        kind = "echo"
        """

    def _edge(self, daemons: Deployment, aggregator: str, peer: str) -> str:
        # Fewer than 64 messages are in flight at once: at 100 Hz about 31 on the longest path (5/300 ms).
        load = f'load = {{ mode = "rate", hz = {HZ:.1f} }}\nmax_in_flight = 64'
        pipelines = _pipeline("small", peer, 1000, load, self.seconds)
        if self.saturated:
            pipelines += _pipeline("images", peer, 1_200_000, "", self.seconds + 2)
        agent = self._agent(daemons, "edge", f'aggregator = "tcp://{aggregator}"')
        return agent + ("" if self.false_time_s is not None else self.clocks.clock_fault()) + pipelines


def _pipeline(name: str, peer: str, size: int, load: str, seconds: float) -> str:
    return f"""
        [[pipeline]]
        name = "{name}"
        sensor = {{ kind = "synthetic", size_bytes = {size} }}
        placement = {{ kind = "remote", peer = "tcp://{peer}", model = "echo" }}
        limit = {{ duration_s = {seconds:.1f} }}
        {load}
    """


def _wall_minus_raw_ns() -> int:
    """Returns the reading of the kernel's wall clock minus the reading of its free-running clock."""
    raw = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
    wall = time.clock_gettime_ns(time.CLOCK_REALTIME)
    return wall - (raw + time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)) // 2


def _since_ns(agent: Program, edge: Host, web: int) -> int:
    """Returns the time on the kernel's wall clock at which the edge's clock fault injection began."""
    url = f"http://127.0.0.1:{web}/api/v1/hosts/edge"
    reported: list[str] = []

    def is_reported() -> bool:
        answer = output(edge.inside(["curl", "--silent", url]) if edge.name else ["curl", "--silent", url])
        clock = json.loads(answer).get("clock") or {}
        # The API calls the clock fault by its former name.
        reported[:] = [fault["since"]] if (fault := clock.get("rehearsal")) else []
        return bool(reported)

    agent.wait_until("the edge reports its clock fault", is_reported)
    seconds, _, fraction = reported[0].rstrip("Z").partition(".")
    whole = int(datetime.fromisoformat(seconds + "+00:00").timestamp())
    return whole * 1_000_000_000 + int(fraction.ljust(9, "0"))
