"""The recorder service: writes what travels in a cell to MCAP files, all the time, on request, or when triggered."""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from zsight.bus.memory_link import matches
from zsight.errors import UsageError, ZsightError
from zsight.recording.capture import Capture, KeyChoice
from zsight.recording.control import Control
from zsight.recording.depth_coder import DepthCoder
from zsight.recording.disk_writer import DiskPolicy, DiskWriter, OnFull
from zsight.recording.file_series import Split
from zsight.recording.memory_ring import MemoryRing
from zsight.recording.recording_file import row_of
from zsight.settings import Live
from zsight.settings import Settings as ServiceSettings
from zsight_protocol.action import Update
from zsight_protocol.channels import Delivery
from zsight_protocol.codec import decode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.find_object import FindObjectResult, ResultCode
from zsight_protocol.message import Header, Time
from zsight_protocol.recording import KeyLoss, RecorderRequest, RecorderState, Recording

if TYPE_CHECKING:
    from zsight.bus import Bus
    from zsight.recording.sample import Sample
    from zsight_protocol.channels import Channel

__all__ = ["Recorder", "Settings", "run"]

log = logging.getLogger(__name__)

_BEAT = 0.5  # seconds between two words of how it stands
_MOST_LOSSES = 64  # keys whose losses are told
_MEBIBYTE = 1 << 20


class Settings(ServiceSettings):
    """Settings of the recorder service; what changes while it runs holds from the next recording on."""

    name: str = Field("recorder", description="name of the recorder in the keys")
    folder: str = Field(".", description="where recordings go; what is asked over the network stays in it")
    start: bool = Field(False, description="begin a recording at once, and not only when asked")
    keys: str = Field("", description="key expressions, spaces between; everything of the cell if not given")
    include: str = Field("", description="regular expression that a key must contain")
    exclude: str = Field("", description="regular expression that a key must not contain")
    compression: Live[Literal["auto", "none", "lz4", "zstd"]] = Field(
        "auto", description="none, lz4, zstd; auto: the smallest that keeps up, by measured speed, chunk by chunk"
    )
    depth_coded: Live[bool] = Field(
        False, description="write clouds of depth cameras as depth and colour images where they come back within 0.1 mm"
    )
    split_size: Live[float] = Field(0, ge=0, description="MiB after which another file begins; 0: never")
    split_time: Live[float] = Field(0, ge=0, description="seconds after which another file begins; 0: never")
    keep: Live[int] = Field(0, ge=0, description="files that are kept where a recording is split; 0: all")
    on_full: Live[OnFull] = Field(
        OnFull.STOP, description="when the disk is full: stop; wait until there is room; drop the oldest file"
    )
    reserve: Live[float] = Field(64, ge=0.25, description="MiB of the disk that are left free (0.25 or more)")
    memory: Live[float] = Field(512, gt=0, description="MiB that may wait to be written before messages are dropped")
    ring: float = Field(
        0, ge=0, le=3600, description="seconds that are kept in memory for a trigger; 0: none (up to 3600)"
    )
    ring_memory: float = Field(1024, gt=0, description="MiB that those seconds may take")
    after: Live[float] = Field(5, ge=0, le=3600, description="seconds that are recorded after a trigger (0 to 3600)")
    trigger_failed_find: Live[bool] = Field(False, description="trigger when a find ends without the object")
    trigger_key: str = Field("", description="trigger when a message comes on this key expression")


def run(bus: Bus, settings: Settings) -> None:
    """Record when asked, until told to stop."""
    recorder = Recorder(bus, settings)
    if settings.start:
        recorder.start()
    bus.ready()
    while not bus.stopping.wait(_BEAT):
        recorder.beat()
    recorder.close()


class Recorder:
    """A recorder on the bus; every method may be called from any thread."""

    def __init__(self, bus: Bus, settings: Settings) -> None:
        """Args: bus; settings."""
        self._bus = bus
        self._settings = settings
        self._default = _choice(bus, settings)
        self._lock = threading.RLock()
        self._disk: DiskWriter | None = None
        self._closing: DiskWriter | None = None  # what waits is still being written
        self._last: RecorderState | None = None  # of the recording before
        self._ring = MemoryRing(settings.ring, int(settings.ring_memory * _MEBIBYTE)) if settings.ring else None
        self._ends: float | None = None
        self._trigger: str | None = None
        self._in_force: dict[tuple[str, int], Sample] = {}
        self._capture: Capture | None = None
        asked = (bus.cell.recorder(settings.name), RecorderRequest)
        told = (bus.cell.recorder_status(settings.name), RecorderState)
        self._control = Control(bus, asked, told, self._do, self.state)
        self._control.serve()
        if self._ring is not None:
            self._read(self._default)
        self._control.tell()

    def close(self) -> None:
        """Stop recording, and reading."""
        self.stop()
        self._control.close()
        if self._capture is not None:
            self._capture.close()

    # What it is asked.

    def start(self, path: str = "", keys: tuple[str, ...] = ()) -> RecorderState:
        """Begin a recording.

        Raises:
            UsageError: one is running already, or the path cannot be used.
        """
        with self._lock:
            if self._disk is not None:
                raise UsageError(f"{self._disk.series.files[-1]} is being recorded already: stop it first")
            choice = self._default if not keys else _with_keys(self._default, keys)
            self._open(path, choice)
            self._ends = None
            if self._ring is None:
                self._read(choice)
        self._control.tell()
        return self.state()

    def stop(self) -> RecorderState:
        """End the recording, if there is one."""
        with self._lock:
            disk, self._disk, self._ends = self._disk, None, None
            self._closing = disk or self._closing
            capture = self._capture if disk is not None and self._ring is None else None
            if capture is not None:
                self._capture, self._in_force = None, {}
        if capture is not None:
            capture.close()  # waits for messages that are just being handed over
        if disk is not None:
            disk.close()
            self._last = self._state_of(disk, Recording.ARMED if self._ring is not None else Recording.IDLE)
            self._closing = None
            log.info("recorded %d messages to %s", disk.messages, ", ".join(map(str, disk.series.files)))
        self._control.tell()
        return self.state()

    def trigger(self, why: str = "asked") -> RecorderState:
        """Write what is kept in memory, and what comes in the seconds that follow.

        Raises:
            UsageError: nothing is kept.
        """
        with self._lock:
            if self._ring is None:
                raise UsageError("nothing is kept in memory: give the recorder the setting ring (seconds)")
            if self._disk is None:
                self._open("", self._default)
            elif self._ends is not None:  # triggered again while it records: that much longer
                self._ends = time.monotonic() + self._settings.after
            log.info("triggered: %s", why)
        self._control.tell()
        return self.state()

    def _open(self, path: str, choice: KeyChoice) -> None:
        place = Path(path).expanduser() if path else Path(self._settings.folder) / _fresh_name()
        if place.suffix != ".mcap":
            place = place.with_name(place.name + ".mcap")
        about = {"recorder": self._settings.name, "keys": " ".join(choice.expressions)}
        try:
            self._disk = DiskWriter(
                place,
                self._bus.cell.namespace,
                about,
                _policy(self._settings),
                in_force=list(self._in_force.values()),
                kept=[] if self._ring is None else self._ring.samples(),
                coded=DepthCoder() if self._settings.depth_coded else lambda _, message: message,
            )
        except OSError as error:
            raise UsageError(f"{place} cannot be written: {error.strerror or error}") from None
        if self._ring is not None:
            self._ring.clear()
            self._ends = time.monotonic() + self._settings.after

    def _read(self, choice: KeyChoice) -> None:
        self._capture = Capture(self._bus, choice, self._arrived, self._lost)

    # Messages come, on the link's threads.

    def _arrived(self, sample: Sample) -> None:
        with self._lock:
            if self._disk is not None:
                self._disk.put(sample)
            elif self._ring is not None:
                self._ring.put(sample)
            row = row_of(sample.key, self._bus.cell.namespace)
            if row is not None and row.delivery is Delivery.LATCHED:
                self._in_force[sample.key, sample.writer] = sample
            if self._ring is not None and self._triggers(sample, row):
                self._trigger = sample.key

    def _lost(self, key: str, count: int) -> None:
        with self._lock:
            if self._disk is not None:
                self._disk.lose(key, count)

    def _triggers(self, sample: Sample, row: Channel | None) -> bool:
        if self._settings.trigger_key and matches(self._settings.trigger_key, sample.key):
            return True
        answers = Update[FindObjectResult]
        if not self._settings.trigger_failed_find or row is None or row.message is not answers:
            return False
        try:
            update = decode(answers, sample.payload)
        except ProtocolError:
            return False
        return update.final and (update.result is None or update.result.code is not ResultCode.FOUND)

    # How it stands.

    def beat(self) -> None:
        """Look after triggers and the end of a recording, and tell how it stands."""
        with self._lock:
            trigger, self._trigger = self._trigger, None
            over = self._ends is not None and time.monotonic() >= self._ends
            over = over or (self._disk is not None and self._disk.ended)
        try:
            if trigger is not None:
                self.trigger(f"a message on {trigger}")
            elif over:
                self.stop()
        except ZsightError as error:
            log.warning("%s", error)
        self._control.tell()

    def state(self) -> RecorderState:
        """How it stands."""
        with self._lock:
            disk = self._disk or self._closing
        if disk is not None:
            return self._state_of(disk, Recording.DISK_FULL if disk.full else Recording.RECORDING)
        state = Recording.ARMED if self._ring is not None else Recording.IDLE
        now, kept = Header(stamp=Time.now()), 0.0 if self._ring is None else self._ring.seconds
        if self._last is not None:
            return self._last.model_copy(update={"header": now, "state": state, "in_memory": kept})
        return RecorderState(header=now, recorder=self._settings.name, state=state, in_memory=kept)

    def _state_of(self, disk: DiskWriter, state: Recording) -> RecorderState:
        losses = disk.losses()
        return RecorderState(
            header=Header(stamp=Time.now()),
            recorder=self._settings.name,
            state=state,
            message=disk.words,
            path=str(disk.series.files[-1]),
            seconds=time.monotonic() - disk.begun,
            messages=disk.messages,
            bytes_in=disk.bytes_in,
            bytes_written=disk.bytes_written,
            bytes_per_second=disk.bytes_per_second,
            lost=sum(losses.values()),
            losses=tuple(KeyLoss(key=key, lost=count) for key, count in list(losses.items())[:_MOST_LOSSES]),
            safe_ns=disk.safe_ns,
            disk_free=disk.disk_free(),
            compression=disk.compression or "none",
            in_memory=0.0 if self._ring is None else self._ring.seconds,
            files=len(disk.series.files),
        )

    def _do(self, wanted: RecorderRequest) -> RecorderState:
        match wanted.action:
            case "start":
                return self.start(_inside(self._settings.folder, wanted.path), wanted.keys)
            case "stop":
                return self.stop()
            case "trigger":
                return self.trigger()
            case _:
                return self.state()


def _inside(folder: str, path: str) -> str:
    """A path that came over the network, in the folder; empty where none came.

    Raises:
        UsageError: it leads out of the folder.
    """
    if not path:
        return ""
    home = Path(folder).expanduser().resolve()
    place = (home / path).resolve()
    if not place.is_relative_to(home):
        raise UsageError(f"{path} is not in the recorder's folder {home}: give a name in it")
    return str(place)


def _policy(settings: Settings) -> DiskPolicy:
    return DiskPolicy(
        split=Split(int(settings.split_size * _MEBIBYTE), settings.split_time, settings.keep),
        on_full=settings.on_full,
        reserve=int(settings.reserve * _MEBIBYTE),
        memory=int(settings.memory * _MEBIBYTE),
        compression=settings.compression,
    )


def _choice(bus: Bus, settings: Settings) -> KeyChoice:
    namespace = bus.cell.namespace
    everything = (f"{namespace}/**", bus.cell.health("*", "*"))
    return KeyChoice(tuple(settings.keys.split()) or everything, settings.include, settings.exclude)


def _with_keys(choice: KeyChoice, keys: tuple[str, ...]) -> KeyChoice:
    return KeyChoice(keys, choice.include, choice.exclude)


def _fresh_name() -> str:
    """The time, to the millisecond: no two recordings of a recorder have the same."""
    now = time.time()
    return time.strftime("%Y-%m-%d_%H-%M-%S", time.localtime(now)) + f".{int(now % 1 * 1000):03d}.mcap"
