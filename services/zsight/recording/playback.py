"""The clock of a player: which message is due when, at any rate, from any place, paused or not."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zsight.errors import UsageError, ZsightError
from zsight.recording.in_force import in_force
from zsight_protocol.errors import ProtocolError
from zsight_protocol.recording import Playing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from zsight.recording.played import Line, Played, Recorded
    from zsight_protocol.message import Message

__all__ = ["Playback", "Ready"]

_AHEAD = 8  # messages that are read before their time
_LATE = 2048  # latest delays that are remembered


@dataclass(frozen=True)
class Ready:
    """A message that was read, and when it is due: ``due`` of monotonic seconds, ``log_time`` of the recording."""

    played: Played
    message: Message | bytes
    due: float
    log_time: int


class Playback:
    """Sends the messages of a recording at their time, on a thread of its own; every method is thread-safe.

    Positions are nanoseconds of the recording's own clock.
    """

    def __init__(
        self,
        recording: Recorded,
        lines: Sequence[Line],
        send: Callable[[Ready], None],
        *,
        start: int | None = None,
        end: int | None = None,
        rate: float = 1.0,
        loop: bool = False,
        paused: bool = False,
    ) -> None:
        """Open the recording at its start.

        Args:
            recording: what is played.
            lines: of it that are sent.
            send: called with each message when it is due, on the player's thread.
            start: first position.
            end: position at which it ends.
            rate: times as fast as it was recorded.
            loop: begin again after the end.
            paused: wait to be told.
        """
        self._recording = recording
        self._lines = list(lines)
        self._send = send
        self.start = recording.start_ns if start is None else start
        self.end = recording.end_ns + 1 if end is None else end
        self.rate = rate
        self.loop = loop
        self.sent = 0
        self.refused = 0
        self.last_refusal = ""
        self.error: ZsightError | None = None
        self.state = Playing.PAUSED if paused else Playing.PLAYING
        self._late: deque[float] = deque(maxlen=_LATE)
        self._changed = threading.Condition()
        self._position = self.start
        self._anchor = (time.monotonic(), self.start)
        self._steps = 0
        self._restore = self.start > recording.start_ns
        self._seeks = 1  # raised by every seek: what was read ahead before it is void
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)

    def begin(self) -> None:
        """Start the thread."""
        self._anchor = (time.monotonic(), self._position)
        self._thread.start()

    # Controls.

    @property
    def position(self) -> int:
        """Where it is now."""
        with self._changed:
            return self._now()

    def _now(self) -> int:
        if self.state is not Playing.PLAYING:
            return self._position
        since, position = self._anchor
        return min(int(position + (time.monotonic() - since) * 1e9 * self.rate), self.end)

    def play(self) -> None:
        """Go on; from the end, begin again."""
        with self._changed:
            if self.state is Playing.ENDED:
                self._seek(self.start)
            self._hold()
            self.state = Playing.PLAYING
            self._changed.notify_all()

    def pause(self) -> None:
        """Stand still."""
        with self._changed:
            self._hold()
            if self.state is Playing.PLAYING:
                self.state = Playing.PAUSED
            self._changed.notify_all()

    def step(self) -> None:
        """Send the next message, and stand still."""
        with self._changed:
            self._hold()
            self.state = Playing.PAUSED
            self._steps += 1
            self._changed.notify_all()

    def seek(self, position: int) -> None:
        """Go to a place: what was in force there is sent at once, then what follows, unless it is paused."""
        with self._changed:
            self._seek(min(max(position, self.start), self.end))
            if self.state is Playing.ENDED:
                self.state = Playing.PAUSED
            self._changed.notify_all()

    def set_rate(self, rate: float) -> None:
        """Play so many times as fast as it was recorded."""
        with self._changed:
            self._hold()
            self.rate = rate
            self._changed.notify_all()

    def _hold(self) -> None:
        self._position = self._now()
        self._anchor = (time.monotonic(), self._position)

    def _seek(self, position: int) -> None:
        self._position = position
        self._anchor = (time.monotonic(), position)
        self._restore = True
        self._steps = 0
        self._seeks += 1

    def wait_ended(self, timeout: float | None = None) -> bool:
        """Wait until it has ended, was closed or failed."""
        with self._changed:
            return self._changed.wait_for(lambda: self.state is Playing.ENDED or self._closing, timeout)

    def wait_settled(self, timeout: float) -> bool:
        """Wait until what a seek or a step asked for was sent."""
        with self._changed:
            return self._changed.wait_for(
                lambda: (not self._restore and not self._steps) or self._closing or self.state is Playing.ENDED, timeout
            )

    def late_p99(self) -> float:
        """Seconds by which the messages of late were sent too late, 99th percentile."""
        late = sorted(self._late.copy())
        return late[int(0.99 * (len(late) - 1))] if late else 0.0

    def close(self) -> None:
        """End, and wait for the thread."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    # The player's thread.

    def _run(self) -> None:
        try:
            while not self._closing:
                self._run_from_here()
        except ZsightError as error:
            self.error = error
        finally:
            with self._changed:
                self.state = Playing.ENDED
                self._closing = True
                self._changed.notify_all()

    def _run_from_here(self) -> None:
        """Send from the position on until the end, or until somebody seeks."""
        with self._changed:
            seeks, position, restore = self._seeks, self._position, self._restore
        if restore:
            for played in in_force(self._recording, self._lines, position):
                self._send_one(played, position)
        with self._changed:
            if seeks != self._seeks:
                return
            self._restore = False
            self._anchor = (time.monotonic(), self._position) if restore else self._anchor
            self._changed.notify_all()
        reader = _ReadAhead(self._recording.messages(position, self.end, self._lines), self._load)
        try:
            while (found := reader.take()) is not None:
                if not self._send_at_its_time(*found, seeks):
                    return
        finally:
            reader.close()
        self._at_the_end(seeks)

    def _send_at_its_time(self, played: Played, message: Message | bytes, seeks: int) -> bool:
        """False where somebody seeks or closes before it is due."""
        with self._changed:
            while True:
                if self._closing or seeks != self._seeks:
                    return False
                if self._steps:
                    self._position = played.log_time
                    self._anchor = (time.monotonic(), self._position)
                    due = time.monotonic()
                    break
                if self.state is not Playing.PLAYING:
                    self._changed.wait()
                    continue
                since, position = self._anchor
                due = since + (played.log_time - position) / 1e9 / self.rate
                left = due - time.monotonic()
                if left <= 0:
                    break
                self._changed.wait(left)
        self._late.append(time.monotonic() - due)
        self._send(Ready(played, message, due, played.log_time))
        with self._changed:
            self.sent += 1
            if self._steps:
                self._steps -= 1
                self._position = played.log_time + 1
            self._changed.notify_all()
        return True

    def _at_the_end(self, seeks: int) -> None:
        with self._changed:
            if self._closing or seeks != self._seeks:
                return
            # The last message is sent; what is left until the end is waited for, so that a loop keeps its period.
            while self.state is Playing.PLAYING and seeks == self._seeks and not self._closing:
                left = (self.end - self._now()) / 1e9 / self.rate
                if left <= 0 or not self.loop:
                    break
                self._changed.wait(left)
            if seeks != self._seeks or self._closing:
                return
            if self.loop and self.state is Playing.PLAYING:
                self._seek(self.start)
                self._restore = self.start > self._recording.start_ns
                return
            self._position = self.end
            self._steps = 0
            self.state = Playing.ENDED
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._closing or seeks != self._seeks)

    def _send_one(self, played: Played, position: int) -> None:
        message = self._load(played)
        if message is not None:
            self._send(Ready(played, message, time.monotonic(), position))

    def _load(self, played: Played) -> Message | bytes | None:
        """The message, or none where it cannot be sent, which is counted."""
        try:
            return played.load()
        except (ProtocolError, UsageError) as error:
            self.refused += 1
            self.last_refusal = f"{played.line.source}: {error}"
            return None


class _ReadAhead:
    """Reads and decodes messages before they are due, on a thread of its own."""

    def __init__(self, messages: Iterator[Played], load: Callable[[Played], Message | bytes | None]) -> None:
        self._messages = messages
        self._load = load
        self._found: deque[tuple[Played, Message | bytes]] = deque()
        self._changed = threading.Condition()
        self._ended = self._closed = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="read ahead", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        try:
            for played in self._messages:
                message = self._load(played)
                if message is None:
                    continue
                with self._changed:
                    self._changed.wait_for(lambda: len(self._found) < _AHEAD or self._closed)
                    if self._closed:
                        return
                    self._found.append((played, message))
                    self._changed.notify_all()
        except Exception as error:  # noqa: BLE001  raised again by who takes
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def take(self) -> tuple[Played, Message | bytes] | None:
        """The next message, or none at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._found or self._ended)
            if self._found:
                found = self._found.popleft()
                self._changed.notify_all()
                return found
            if self._error is not None:
                raise self._error
            return None

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()
