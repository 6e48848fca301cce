"""Lag of the live figures: from the end of an iteration to the first answer that counts it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from http_api import Api

# Longest measurement. It is shorter than the longest window of the live figures (60 s), so this window counts all
# iterations of the pipeline.
LONGEST_S = 55.0
POLL_S = 0.01


@dataclass
class CountTimes:
    """Times at which the live figures first counted each number of iterations."""

    host: str
    pipeline: str
    seen: list[tuple[float, int]] = field(default_factory=list)

    def update(self, api: Api) -> None:
        count = api.iterations_in_last_minute(self.host, self.pipeline)
        if not self.seen or count > self.seen[-1][1]:
            self.seen.append((time.time(), count))

    def lags(self, ends: list[float]) -> list[float]:
        """Returns the lag of each iteration, seconds. `ends` are the ends of the iterations, Unix time, ascending."""
        lags, counted = [], 0
        for when, count in self.seen:
            lags.extend(when - end for end in ends[counted:count])
            counted = max(counted, count)
        return lags


def poll(api: Api, count_times: CountTimes, seconds: float, should_continue: Callable[[], bool] = lambda: True) -> None:
    """Polls for `seconds`, but at most for LONGEST_S, and only as long as `should_continue` returns true."""
    deadline = time.monotonic() + min(seconds, LONGEST_S)
    while time.monotonic() < deadline and should_continue():
        count_times.update(api)
        time.sleep(POLL_S)
