"""The parts of the benchmark, by name, in the order in which they run."""

from __future__ import annotations

from types import ModuleType

from . import (
    agent,
    attacked,
    batching,
    browser,
    decoding,
    delays,
    detection,
    efficientnet,
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
    streaming,
    violations,
)

# Each part has `prepare()`, which builds and checks what the part needs, and `measure(quick) -> Section`.
ALL: dict[str, ModuleType] = {
    "node": node,
    "loop": loop,
    "networks": networks,
    "python": python,
    "model": model,
    "detection": detection,
    "efficientnet": efficientnet,
    "batching": batching,
    "decoding": decoding,
    "streaming": streaming,
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
