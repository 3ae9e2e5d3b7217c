"""Takes every message of some keys off the wire, in the order in which they arrive."""

from __future__ import annotations

import re
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zsight.bus.attachment import Attachment
from zsight.bus.counters import ReadCounter
from zsight.bus.memory_link import matches
from zsight.errors import UsageError
from zsight.recording.recording_file import row_of
from zsight.recording.sample import Sample
from zsight_protocol.channels import CHANNELS, Delivery

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Bus, RawSample
    from zsight.bus.link import RawReader

__all__ = ["Capture", "KeyChoice"]


@dataclass(frozen=True)
class KeyChoice:
    """Which keys are wanted: key expressions, and regular expressions that a key must and must not contain."""

    expressions: tuple[str, ...]
    include: str = ""
    exclude: str = ""

    def __post_init__(self) -> None:
        for pattern in (self.include, self.exclude):
            try:
                re.compile(pattern)
            except re.error as error:
                raise UsageError(f"{pattern!r} is no regular expression: {error}") from None

    def wants(self, key: str) -> bool:
        """Whether a key that an expression met is wanted."""
        return (not self.include or re.search(self.include, key) is not None) and (
            not self.exclude or re.search(self.exclude, key) is None
        )


class Capture:
    """Reads until it is closed, and hands every message on, one at a time, from the link's threads.

    Latched values that were sent before come first. No two messages have the same time.
    """

    def __init__(
        self,
        bus: Bus,
        choice: KeyChoice,
        arrived: Callable[[Sample], None],
        lost: Callable[[str, int], None],
    ) -> None:
        """Args: bus; keys; called with every message, must not wait; called with a key and how many are missing."""
        self._namespace = bus.cell.namespace
        self._choice = choice
        self._arrived = arrived
        self._lost = lost
        self._lock = threading.Lock()
        self._last_ns = 0
        self._wanted: dict[str, tuple[bool, int]] = {}  # by key: latched, number of its first expression; -1 for none
        self._counter = ReadCounter("")
        latched = [f"{self._namespace}/{row.pattern}" for row in CHANNELS if row.delivery is Delivery.LATCHED]
        readers: list[RawReader] = []
        for pattern in latched:
            if any(matches(expression, pattern) for expression in choice.expressions):
                readers.append(bus.link.reader(pattern, Delivery.LATCHED, self._latched))  # noqa: PERF401
        for number, expression in enumerate(choice.expressions):
            readers.append(bus.link.reader(expression, Delivery.EVERY, self._of_expression(number)))
        self._readers = readers

    def close(self) -> None:
        """Stop reading."""
        for reader in self._readers:
            reader.close()

    def _of_expression(self, number: int) -> Callable[[RawSample], None]:
        def arrived(raw: RawSample) -> None:
            if self._about(raw.key) == (False, number):
                self._take(raw)

        return arrived

    def _latched(self, raw: RawSample) -> None:
        is_latched, number = self._about(raw.key)
        if is_latched and number >= 0:
            self._take(raw)

    def _about(self, key: str) -> tuple[bool, int]:
        if key not in self._wanted:
            row = row_of(key, self._namespace)
            met = (n for n, expression in enumerate(self._choice.expressions) if matches(expression, key))
            number = next(met, -1) if self._choice.wants(key) else -1
            self._wanted[key] = row is not None and row.delivery is Delivery.LATCHED, number
        return self._wanted[key]

    def _take(self, raw: RawSample) -> None:
        payload = raw.take()
        attachment = Attachment.unpack(raw.attachment)
        key = raw.key
        with self._lock:
            now = self._last_ns = max(time.time_ns(), self._last_ns + 1)
            missing = self._counter.arrived(attachment, now) + (payload is None)
            if missing:
                self._lost(key, missing)
            if payload is not None:
                self._arrived(Sample(key, payload, attachment, now))
