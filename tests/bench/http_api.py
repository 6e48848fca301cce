"""Client of the REST API of a running aggregator, with one connection that stays open."""

from __future__ import annotations

import http.client
import json
from typing import Any

from programs import Failure


class Api:
    """`GET` on the REST API of one daemon."""

    def __init__(self, port: int) -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)

    def get(self, path: str) -> dict[str, Any] | None:
        """Returns the answer; `None` if the item does not exist yet."""
        self._connection.request("GET", f"/api/v1/{path}")
        response = self._connection.getresponse()
        body = response.read()
        if response.status == 404:
            return None
        if response.status != 200:
            raise Failure(f"GET /api/v1/{path} answered {response.status}: {body[:200]!r}")
        answer: dict[str, Any] = json.loads(body)
        return answer

    def waiting_events(self, host: str) -> int | None:
        """Returns the number of events that a host reports as not acknowledged; `None` before its first report."""
        answer = self.get(f"hosts/{host}")
        return None if answer is None or answer["now"] is None else int(answer["now"]["events"]["waiting"])

    def iterations_in_last_minute(self, host: str, pipeline: str) -> int:
        """Returns the number of iterations of a pipeline that the live figures count in the last minute."""
        answer = self.get(f"pipelines/{host}/{pipeline}")
        if answer is None:
            return 0
        minute = max(answer["windows"], key=lambda window: int(window["seconds"]))
        return sum(minute["counts"].values())
