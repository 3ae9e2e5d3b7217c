"""Keeps whoever makes a process complain over and over from filling its log."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["FEW", "SPAN", "LogFlood"]

FEW = 20
"""Complaints of one place in the code that are logged within SPAN."""

SPAN = 10.0
"""Seconds."""


@dataclass
class _Window:
    start: float
    events: int = 0


class LogFlood(logging.Filter):
    """Lets through the first few warnings and errors of each place in the code in every span of time.

    The next one that gets through tells how many were left out.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Args: clock in seconds."""
        super().__init__()
        self._clock = clock
        self._windows: dict[tuple[str, int], _Window] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """True where the event is logged; called under the lock of the handler."""
        if record.levelno < logging.WARNING:
            return True
        place = (record.pathname, record.lineno)
        window = self._windows.get(place)
        if window is None or self._clock() >= window.start + SPAN:
            left_out = 0 if window is None else window.events - FEW
            self._windows[place] = window = _Window(self._clock())
            if left_out > 0 and not hasattr(record, "left_out"):
                # Every handler has a filter of its own: the first one tells.
                record.left_out = left_out
                record.msg, record.args = f"{record.getMessage()} (and {left_out} more like this before)", ()
        window.events += 1
        return window.events <= FEW
