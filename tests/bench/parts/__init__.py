"""The parts of the benchmark, by name, in the order in which they run."""

from __future__ import annotations

from types import ModuleType

from . import (
    agent,
    attacked,
    browser,
    delays,
    idle,
    ingest,
    live,
    loop,
    model,
    networks,
    node,
    pages,
    python,
    stream,
    violations,
)

# Each has `prepare()`, which builds and checks what it needs, and `measure(quick) -> Section`.
ALL: dict[str, ModuleType] = {
    "node": node,
    "loop": loop,
    "networks": networks,
    "python": python,
    "model": model,
    "ingest": ingest,
    "stream": stream,
    "live": live,
    "pages": pages,
    "delays": delays,
    "violations": violations,
    "idle": idle,
    "agent": agent,
    "attacked": attacked,
    "browser": browser,
}
