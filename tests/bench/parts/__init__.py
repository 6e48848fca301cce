"""The parts of the benchmark, by name, in the order in which they run."""

from __future__ import annotations

from types import ModuleType

from . import delays, idle, ingest, loop, model, node

# Each has `prepare()`, which builds and checks what it needs, and `measure(quick) -> Section`.
ALL: dict[str, ModuleType] = {
    "node": node,
    "loop": loop,
    "model": model,
    "ingest": ingest,
    "delays": delays,
    "idle": idle,
}
