"""Tells watchers which goals a server holds, soon after a change and never more often than they can read."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING

from zsight.errors import ConnectionLost

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Writer
    from zsight_protocol.action import GoalStatusList

__all__ = ["StatusBoard"]

log = logging.getLogger(__name__)

_PAUSE = 0.05  # seconds between two lists


class StatusBoard:
    """Sends the list of goals on a thread of its own, so that goals do not wait for it."""

    def __init__(self, writer: Writer[GoalStatusList], present: Callable[[], GoalStatusList]) -> None:
        """Args: writer of the latched list; present: makes the list as it is now."""
        self._writer = writer
        self._present = present
        self._changed = threading.Event()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)
        self._changed.set()
        self._thread.start()

    def changed(self) -> None:
        """Something changed: send the list soon."""
        self._changed.set()

    def close(self) -> None:
        """Send what is left to be said, and end."""
        self._closed.set()
        self._changed.set()
        self._thread.join()

    def _run(self) -> None:
        last = False
        while not last:
            self._changed.wait()
            last = self._closed.is_set()
            self._changed.clear()
            try:
                self._writer.send(self._present())
            except ConnectionLost as error:
                log.debug("no status sent: %s", error)
            self._closed.wait(_PAUSE)
