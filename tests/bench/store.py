"""What an aggregator stored of a run, read from its SQLite file: every sample, not a summary."""

from __future__ import annotations

import sqlite3
from collections import defaultdict
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from quantiles import spread

# Condition of the iterations that count: of one run, after the warm-up, successful.
COUNTED = "iteration.run = ? AND iteration.warm_up = 0 AND iteration.outcome = 0"


@dataclass(frozen=True)
class Run:
    """A run of a pipeline."""

    number: int
    has_ended: bool
    # Numbers of iterations that succeeded and that did not.
    ok: int
    unsuccessful: int


@contextmanager
def _open(database: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=30)) as connection:
        yield connection


def run_of(database: Path, pipeline: str) -> Run | None:
    """Returns the newest run of a pipeline; `None` if no run is stored."""
    with _open(database) as connection:
        row = connection.execute(
            "SELECT run.number, run.ended_ns IS NOT NULL, run.ok, run.failed + run.lost + run.timeout"
            " FROM run JOIN pipeline ON pipeline.id = run.pipeline WHERE pipeline.name = ?"
            " ORDER BY run.number DESC LIMIT 1",
            (pipeline,),
        ).fetchone()
    return None if row is None else Run(row[0], bool(row[1]), row[2], row[3])


def missing(database: Path) -> int:
    """Returns the number of events that were measured but not stored."""
    with _open(database) as connection:
        return int(connection.execute("SELECT coalesce(sum(count), 0) FROM gap").fetchone()[0])


def iterations_per_second(database: Path, run: Run) -> float:
    """Returns the iterations per second between the first and the last iteration that counts.

    The numbers of iterations have no gaps, so iterations that are not stored are included.
    """
    with _open(database) as connection:
        first, last, begin, end = connection.execute(
            f"SELECT min(number), max(number), min(started_ns), max(started_ns) FROM iteration WHERE {COUNTED}",
            (run.number,),
        ).fetchone()
    if first is None or end == begin:
        return 0.0
    return int(last - first) / (int(end - begin) * 1e-9)


def samples(database: Path, run: Run, names: tuple[str, ...] | None = None) -> dict[str, list[float]]:
    """Returns the values of the nodes with these names, by name, in SI units.

    Returns the values of all nodes if `names` is `None`.
    """
    only = "" if names is None else f"AND name.text IN ({', '.join('?' * len(names))})"
    query = (
        "SELECT name.text, node.value FROM iteration"
        " JOIN node ON node.run = iteration.run AND node.iteration = iteration.number"
        f" JOIN name ON name.id = node.name WHERE {COUNTED} AND node.value IS NOT NULL {only}"
    )
    values: dict[str, list[float]] = defaultdict(list)
    with _open(database) as connection:
        for name, value in connection.execute(query, (run.number, *(names or ()))):
            values[name].append(value)
    return dict(values)


def stages(database: Path, run: Run) -> dict[str, dict[str, float]]:
    """Returns count, median and 99th percentile of every node name."""
    return {name: spread(values) for name, values in samples(database, run).items()}


@dataclass(frozen=True)
class Delay:
    """A one-way delay as it was reported, seconds, and the stamps of both hosts."""

    sent_ns: int
    received_ns: int
    value: float | None
    lo: float | None
    hi: float | None
    verdict: str


def delays(database: Path, run: Run, name: str, *, wall: bool = False) -> list[Delay]:
    """Returns the delays of one name, in no particular order.

    Their stamps are of the wall clocks if `wall`, else of the free-running clocks.
    """
    sent, received = ("sent_ns", "received_ns") if wall else ("sent_raw_ns", "received_raw_ns")
    query = (
        f"SELECT transit.{sent}, transit.{received}, node.value, node.lo, node.hi, coalesce(verdict.text, '')"
        " FROM iteration JOIN node ON node.run = iteration.run AND node.iteration = iteration.number"
        " JOIN transit ON transit.run = node.run AND transit.iteration = node.iteration AND transit.node = node.node"
        " JOIN name ON name.id = node.name LEFT JOIN verdict ON verdict.id = transit.verdict"
        f" WHERE {COUNTED} AND name.text = ? AND transit.{sent} IS NOT NULL AND transit.{received} IS NOT NULL"
    )
    with _open(database) as connection:
        return [Delay(*row) for row in connection.execute(query, (run.number, name))]


def ends(database: Path, run: Run) -> list[float]:
    """Returns the ends of the iterations that count, seconds since 1970 on the edge's clock, ascending."""
    query = f"SELECT started_ns * 1e-9 + total FROM iteration WHERE {COUNTED} AND total IS NOT NULL"
    with _open(database) as connection:
        return sorted(end for (end,) in connection.execute(query, (run.number,)))


def nodes(database: Path) -> int:
    """Returns the number of stored nodes of all hosts."""
    with _open(database) as connection:
        return int(connection.execute("SELECT coalesce(sum(nodes), 0) FROM host").fetchone()[0])


def produced(spool: Path) -> int:
    """Returns the number of events that an agent has written to its spool or dropped."""
    with _open(spool) as connection:
        row = connection.execute("SELECT produced FROM stream").fetchone()
    return 0 if row is None else int(row[0])
