"""The player service: sends a recording as if it were live, controlled by requests."""

from __future__ import annotations

import logging
import re
import threading
import time
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from zsight.bus.attachment import Attachment, new_writer_id
from zsight.errors import UsageError
from zsight.recording.control import Control
from zsight.recording.opening import open_recording
from zsight.recording.playback import Playback
from zsight.recording.stamp_shift import shifted
from zsight.settings import Live
from zsight.settings import Settings as ServiceSettings
from zsight_protocol.channels import Delivery
from zsight_protocol.message import Header, Time
from zsight_protocol.recording import Clock, PlayerRequest, PlayerState, Playing

if TYPE_CHECKING:
    from zsight.bus import Bus, Writer
    from zsight.recording.playback import Ready
    from zsight.recording.played import Line, Recorded

__all__ = ["Player", "Settings", "Stamps", "run"]

log = logging.getLogger(__name__)

_BEAT = 0.25  # seconds between two words of how it stands
_CLOCK_EVERY = 0.01  # seconds between two times on the clock
_SETTLE = 10.0  # seconds that a seek may take before its answer is given anyhow


class Stamps(StrEnum):
    """What the headers of messages say that are sent again."""

    KEPT = "kept"  # when they were measured
    NOW = "now"  # as if they were measured now


class Settings(ServiceSettings):
    """Settings of the player service."""

    name: str = Field("player", description="name of the player in the keys")
    file: str = Field("", description="recording that is open from the beginning: .mcap, .bag, or a folder")
    paused: bool = Field(False, description="wait to be told to play")
    rate: float = Field(1.0, gt=0, le=1000, description="times as fast as it was recorded (above 0, up to 1000)")
    loop: bool = Field(False, description="begin again after the end")
    start: float = Field(0.0, ge=0, description="seconds from the beginning at which it starts")
    end: float | None = Field(None, gt=0, description="seconds from the beginning at which it ends")
    duration: float | None = Field(None, gt=0, description="seconds from the start after which it ends")
    topics: str = Field("", description="regular expression that a key or topic must contain")
    exclude: str = Field("", description="regular expression that a key or topic must not contain")
    remap: str = Field("", description="OLD=NEW, spaces between: keys without namespace, or topics, that go elsewhere")
    stamps: Live[Stamps] = Field(Stamps.KEPT, description="stamps in headers: kept, or moved to now")
    clock: bool = Field(False, description="tell the recording's time on the key clock")
    housekeeping: Live[bool] = Field(
        False, description="send health and other keys that begin with @ as well, of what is opened next"
    )


def run(bus: Bus, settings: Settings) -> None:
    """Play when asked, until told to stop."""
    player = Player(bus, settings)
    if settings.file:
        player.open(settings.file)
    bus.ready()
    while not bus.stopping.wait(_BEAT):
        player.tell()
    player.close()


class Player:
    """A player on the bus; every method may be called from any thread."""

    def __init__(self, bus: Bus, settings: Settings) -> None:
        """Args: bus; settings.

        Raises:
            UsageError: a setting makes no sense.
        """
        self._bus = bus
        self._settings = settings
        self._include = _expression(settings.topics)
        self._exclude = _expression(settings.exclude)
        self._remap = _remapping(settings.remap)
        self._lock = threading.RLock()
        self._recording: Recorded | None = None
        self.playback: Playback | None = None
        self._path = ""
        self._left_out: list[str] = []  # what is wrong with each damaged chunk of it
        self._outlets: dict[str, _Outlet] = {}
        self._clock = bus.writer(bus.cell.clock, Clock) if settings.clock else None
        self._next_clock = 0.0
        asked = (bus.cell.player(settings.name), PlayerRequest)
        told = (bus.cell.player_status(settings.name), PlayerState)
        self._control = Control(bus, asked, told, self.do, self.state)
        self._control.serve()
        self.tell()

    def open(self, path: str) -> None:
        """Open a recording, in place of one that is open.

        Raises:
            UsageError: it cannot be read, or nothing of it is to be sent.
        """
        left_out: list[str] = []
        recording = open_recording(Path(path).expanduser(), partial(_leave_out, left_out))
        lines = [line for line in recording.lines if self._wants(line)]
        if not lines:
            recording.close()
            raise UsageError(f"nothing of {path} is to be sent: see its keys with: zsight bag info {path}")
        if recording.damage:
            log.warning(
                "%s: %s; it is played as far as it goes: mend it with: zsight bag recover", path, recording.damage
            )
        s = self._settings
        start = recording.start_ns + int(s.start * 1e9)
        ends = [recording.end_ns + 1]
        ends += [] if s.end is None else [recording.start_ns + int(s.end * 1e9)]
        ends += [] if s.duration is None else [start + int(s.duration * 1e9)]
        if start >= min(ends):
            recording.close()
            raise UsageError(f"the part from {s.start:g} s on is empty: {path} is {_span(recording):.3f} s long")
        playback = Playback(
            recording, lines, self._send, start=start, end=min(ends), rate=s.rate, loop=s.loop, paused=s.paused
        )
        with self._lock:
            self._close_recording()
            self._recording, self.playback, self._path, self._left_out = recording, playback, path, left_out
            for line in lines:
                self._outlet(line)
            playback.begin()
        self.tell()

    def _wants(self, line: Line) -> bool:
        names = (line.key, line.source)
        if line.key.startswith("@") and not self._settings.housekeeping:
            return False
        if self._include is not None and not any(map(self._include.search, names)):
            return False
        return self._exclude is None or not any(map(self._exclude.search, names))

    def _close_recording(self) -> None:
        if self.playback is not None:
            self.playback.close()
        for outlet in self._outlets.values():
            outlet.close()
        self._outlets = {}
        if self._recording is not None:
            self._recording.close()
        self.playback = self._recording = None

    def close(self) -> None:
        """Stop playing."""
        self._control.close()
        with self._lock:
            self._close_recording()

    # A message is due, on the playback's thread.

    def _send(self, ready: Ready) -> None:
        if self._clock is not None and time.monotonic() >= self._next_clock:
            self._next_clock = time.monotonic() + _CLOCK_EVERY
            self._clock.send(Clock(clock=Time.from_ns(ready.log_time)))
        outlet = self._outlets[ready.played.line.full_key(self._bus.cell.namespace)]
        message = ready.message
        if isinstance(message, bytes):
            outlet.send_bytes(message)
            return
        if self._settings.stamps is Stamps.NOW:
            due_ns = time.time_ns() + int((ready.due - time.monotonic()) * 1e9)
            message = shifted(message, due_ns - ready.log_time)
        outlet.send(message)

    def _outlet(self, line: Line) -> None:
        key = line.full_key(self._bus.cell.namespace)
        if key in self._outlets:
            return
        new = self._remap.get(line.key, self._remap.get(line.source))
        target = key if new is None else new[1:] if new.startswith("/") else f"{self._bus.cell.namespace}/{new}"
        self._outlets[key] = _Outlet(self._bus, target, line)

    # How it stands, and what it is asked.

    def state(self) -> PlayerState:
        """How it stands."""
        header = Header(stamp=Time.now())
        with self._lock:
            playback, recording = self.playback, self._recording
            if playback is None or recording is None:
                return PlayerState(header=header, player=self._settings.name, state=Playing.EMPTY)
            damage = next(iter(self._left_out), recording.damage)
            words = str(playback.error or playback.last_refusal or damage)
            return PlayerState(
                header=header,
                player=self._settings.name,
                state=playback.state,
                message=words,
                path=self._path,
                position=max(playback.position - recording.start_ns, 0) / 1e9,
                duration=_span(recording),
                start_ns=max(recording.start_ns, 0),
                rate=playback.rate,
                loop=playback.loop,
                sent=playback.sent,
                skipped=playback.refused + sum(recording.skipped.values()),
                damaged=len(self._left_out),
                late_p99_ms=playback.late_p99() * 1e3,
            )

    def tell(self) -> None:
        """Tell everybody how it stands."""
        self._control.tell()

    def do(self, wanted: PlayerRequest) -> PlayerState:
        """Do what a request asks; how it stands afterwards.

        Raises:
            UsageError: something is missing in it, or no recording is open.
        """
        if wanted.action == "open":
            self.open(wanted.path)
        elif wanted.action != "status":
            self._steer(wanted)
            self.tell()
        return self.state()

    def _steer(self, wanted: PlayerRequest) -> None:
        playback, recording = self.playback, self._recording
        if playback is None or recording is None:
            raise UsageError("no recording is open: open one first")
        match wanted.action:
            case "play":
                playback.play()
            case "pause":
                playback.pause()
            case "toggle":
                playback.pause() if playback.state is Playing.PLAYING else playback.play()
            case "step":
                playback.step()
                playback.wait_settled(_SETTLE)
            case "seek":
                playback.seek(recording.start_ns + int(_given(wanted.position, "position") * 1e9))
                playback.wait_settled(_SETTLE)
            case "rate":
                playback.set_rate(_given(wanted.rate, "rate"))
            case "loop":
                playback.loop = not playback.loop if wanted.loop is None else wanted.loop


class _Outlet:
    """One key that is sent on: typed where the channel table knows it, else bytes."""

    def __init__(self, bus: Bus, key: str, line: Line) -> None:
        self._writer: Writer[Any] | None = bus.writer(key, line.kind) if line.kind is not None else None
        self._raw = bus.link.writer(key, Delivery.EVERY) if line.kind is None else None
        self._id, self._sent = new_writer_id(), 0

    def send(self, message: Any) -> None:
        if self._writer is not None:
            self._writer.send(message)

    def send_bytes(self, payload: bytes) -> None:
        if self._raw is not None:
            self._sent += 1
            self._raw.put(payload, b"", Attachment(self._id, self._sent, time.time_ns()).pack())

    def close(self) -> None:
        for writer in (self._writer, self._raw):
            if writer is not None:
                writer.close()


def _leave_out(known: list[str], path: Path, words: str) -> None:
    """Say once that a chunk is damaged."""
    told = f"{path}: {words}"
    if told not in known:
        known.append(told)
        log.warning("%s; it is left out: mend the file with: zsight bag recover", told)


def _given(value: float | None, name: str) -> float:
    if value is None:
        raise UsageError(f"the request has no {name}; expected one")
    return value


def _span(recording: Recorded) -> float:
    return (recording.end_ns - recording.start_ns) / 1e9


def _expression(text: str) -> re.Pattern[str] | None:
    try:
        return re.compile(text) if text else None
    except re.error as error:
        raise UsageError(f"{text!r} is no regular expression: {error}") from None


def _remapping(text: str) -> dict[str, str]:
    pairs = [pair.partition("=") for pair in text.split()]
    if not all(old and new for old, _, new in pairs):
        raise UsageError(f"the remapping is {text!r}; expected OLD=NEW, spaces between")
    return {old: new for old, _, new in pairs}
