"""Waiting for what happens on other threads, always with a deadline."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Bus

__all__ = ["DEADLINE", "Arrivals", "known", "soon"]

DEADLINE = 10.0  # seconds; far more than anything here takes, so that a slow machine is no failure

T = TypeVar("T")


class Arrivals(Generic[T]):
    """What callbacks of other threads handed in, in order."""

    def __init__(self) -> None:
        self.all: list[T] = []
        self._changed = threading.Condition()

    def add(self, value: T) -> None:
        with self._changed:
            self.all.append(value)
            self._changed.notify_all()

    def wait(self, count: int) -> list[T]:
        """The first count of them."""
        with self._changed:
            came = self._changed.wait_for(lambda: len(self.all) >= count, DEADLINE)
            assert came, f"{len(self.all)} of {count} came within {DEADLINE:g} s: {self.all}"
            return list(self.all)


def soon(happened: Callable[[], bool], deadline: float = DEADLINE) -> bool:
    """Whether a state that nobody announces is reached within the deadline."""
    end, pause = time.monotonic() + deadline, threading.Event()
    while not happened():
        if time.monotonic() > end:
            return False
        pause.wait(0.002)
    return True


def known(server: Bus, client: Bus) -> None:
    """Wait until the client's network knows what the server has declared: declarations come in order."""
    token = server.link.declare_alive(server.cell.alive("here", "test"))
    key = client.cell.alive("here", "test")
    assert soon(lambda: bool(client.link.alive(key, 1.0)))
    token.close()
