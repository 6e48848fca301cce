"""Medians and 99th percentiles, all from raw samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import median


def quantile(ordered: Sequence[float], q: float) -> float:
    """Returns the sample of nearest rank; `ordered` must be sorted and not empty."""
    return ordered[min(len(ordered) - 1, int(q * len(ordered)))]


def spread(samples: Iterable[float]) -> dict[str, float]:
    """Returns count, median and 99th percentile of at least one sample, in the unit of the samples."""
    ordered = sorted(samples)
    return {"count": len(ordered), "p50": quantile(ordered, 0.50), "p99": quantile(ordered, 0.99)}


def median_spread(spreads: Sequence[dict[str, float]]) -> dict[str, float]:
    """Combines the spreads of several repeats: median of the medians, of the 99th percentiles, and of the counts."""
    return {key: median(one[key] for one in spreads) for key in ("count", "p50", "p99")}
