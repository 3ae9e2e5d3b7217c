"""Answers requests on threads of its own, so that the link's thread, which all of a process share, never waits."""

from __future__ import annotations

import logging
import queue
import threading
from typing import TYPE_CHECKING

from zsight import limits

if TYPE_CHECKING:
    from zsight.bus.link import RawRequest, RequestHandler

__all__ = ["RequestQueue"]

log = logging.getLogger(__name__)


class RequestQueue:
    """Requests that wait to be answered, first come first served; one that finds no room is refused at once."""

    def __init__(self, name: str, *, threads: int = 1) -> None:
        """Args: name of the threads; how many requests are answered at once."""
        self._waiting: queue.Queue[tuple[RawRequest, RequestHandler] | None] = queue.Queue(limits.WAITING)
        self._closed = threading.Event()
        self._threads = [threading.Thread(target=self._run, name=name, daemon=True) for _ in range(threads)]
        for thread in self._threads:
            thread.start()

    def put(self, request: RawRequest, answer: RequestHandler) -> None:
        """Have a request answered; returns at once."""
        try:
            self._waiting.put_nowait((request, answer))
        except queue.Full:
            log.warning("refused a request on %s: %d wait already", request.key, self._waiting.maxsize)
            request.refuse(f"{self._waiting.maxsize} requests wait already: ask again later")

    def close(self) -> None:
        """Refuse what still waits, and end when what is at work is answered."""
        self._closed.set()
        for _ in self._threads:
            self._waiting.put(None)
        for thread in self._threads:
            thread.join()

    def _run(self) -> None:
        while (entry := self._waiting.get()) is not None:
            request, answer = entry
            try:
                if self._closed.is_set():
                    request.refuse("the server stops")
                else:
                    answer(request)
            except Exception:
                log.exception("no answer to a request on %s", request.key)
                request.close()
