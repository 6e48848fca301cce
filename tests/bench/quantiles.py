"""Medians and 99th percentiles, all from raw samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import median


def quantile(ordered: Sequence[float], q: float) -> float:
    """The sample of nearest rank; `ordered` must rise and hold at least one."""
    return ordered[min(len(ordered) - 1, int(q * len(ordered)))]


def spread(samples: Iterable[float]) -> dict[str, float]:
    """Count, median and 99th percentile of at least one sample, in the samples' own unit."""
    ordered = sorted(samples)
    return {"count": len(ordered), "p50": quantile(ordered, 0.50), "p99": quantile(ordered, 0.99)}


def median_spread(spreads: Sequence[dict[str, float]]) -> dict[str, float]:
    """Several repeats as one: the median of the medians, of the 99th percentiles, of the counts."""
    return {key: median(one[key] for one in spreads) for key in ("count", "p50", "p99")}
