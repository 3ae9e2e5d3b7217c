"""Lets requests through up to their greatest size and rate, and refuses the others at once."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

from zsight import limits

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus.link import RawRequest, RequestHandler

__all__ = ["Gate"]

log = logging.getLogger(__name__)


class Gate:
    """A request handler in front of another."""

    def __init__(self, handler: RequestHandler, clock: Callable[[], float] = time.monotonic) -> None:
        """Args: handler of what is let through; clock in seconds."""
        self._handler = handler
        self._clock = clock
        self._room = limits.REQUESTS_PER_SECOND  # a second's worth may come at once
        self._seen = clock()

    def __call__(self, request: RawRequest) -> None:
        """Hand a request on, or refuse it; called on the link's thread alone."""
        words = self._objection(request)
        if words is None:
            self._handler(request)
            return
        log.warning("refused a request on %s: %s", request.key, words)
        request.refuse(words)

    def _objection(self, request: RawRequest) -> str | None:
        now = self._clock()
        self._room = min(self._room + (now - self._seen) * limits.REQUESTS_PER_SECOND, limits.REQUESTS_PER_SECOND)
        self._seen = now
        if len(request.payload) > limits.REQUEST_BYTES:
            return f"a request of {len(request.payload)} bytes; expected at most {limits.REQUEST_BYTES}"
        if self._room < 1:
            return f"more than {limits.REQUESTS_PER_SECOND:g} requests a second; ask less often"
        self._room -= 1
        return None
