"""Lag of the live figures: from the end of an iteration to the first answer that counts it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from http_api import Api

# A pipeline younger than the longest window of the live figures: that window counts all its iterations.
LONGEST_S = 55.0
POLL_S = 0.01


@dataclass
class Watched:
    """Times at which the live figures first counted each number of iterations."""

    host: str
    pipeline: str
    seen: list[tuple[float, int]] = field(default_factory=list)

    def look(self, api: Api) -> int:
        count = api.ended(self.host, self.pipeline)
        if not self.seen or count > self.seen[-1][1]:
            self.seen.append((time.time(), count))
        return count

    def lags(self, ends: list[float]) -> list[float]:
        """Seconds per iteration; `ends` are their ends, seconds since 1970, in increasing order."""
        lags, at = [], 0
        for when, count in self.seen:
            lags.extend(when - end for end in ends[at:count])
            at = max(at, count)
        return lags


def watch(api: Api, watched: Watched, seconds: float, meanwhile: Callable[[], bool] = lambda: True) -> None:
    """Polls for `seconds`, or until `meanwhile` returns false."""
    deadline = time.monotonic() + min(seconds, LONGEST_S)
    while time.monotonic() < deadline and meanwhile():
        watched.look(api)
        time.sleep(POLL_S)
