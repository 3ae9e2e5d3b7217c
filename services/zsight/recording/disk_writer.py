"""Writes samples to disk on threads of its own, so that nobody who brings one ever waits."""

from __future__ import annotations

import logging
import shutil
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from zsight.bus.counters import Rate
from zsight.recording.compression import CompressionChoice
from zsight.recording.file_series import FileSeries, Split
from zsight.recording.recording_file import RecordingFile, row_of
from zsight_protocol.channels import Delivery

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from zsight.recording.sample import Sample
    from zsight_protocol.message import Message

__all__ = ["DiskPolicy", "DiskWriter", "OnFull"]

log = logging.getLogger(__name__)

_CHUNK_SECONDS = 0.4  # a chunk is closed after this, full or not: what is in it is lost in a crash
_LOOK_AGAIN = 0.5  # seconds between two looks for room on a full disk


class OnFull(StrEnum):
    """What happens when the disk is full."""

    STOP = "stop"  # the file is closed, and the recording ends
    WAIT = "wait"  # the file is closed; another one begins as soon as there is room
    OLDEST = "oldest"  # the oldest file of this recording gives way; without one: wait


@dataclass(frozen=True)
class DiskPolicy:
    """How a recording is laid out on the disk.

    ``reserve`` bytes of the disk are left free; ``memory`` bytes may wait to be written before messages are dropped.
    """

    split: Split = field(default_factory=Split)
    on_full: OnFull = OnFull.STOP
    reserve: int = 64 << 20
    memory: int = 512 << 20
    compression: str = "auto"


class DiskWriter:
    """One recording, from its start to its stop.

    ``put`` never waits: what finds no room in memory is dropped and counted. One thread writes; another waits for the
    disk, so that a slow one does not hold up the first.
    """

    def __init__(
        self,
        path: Path,
        namespace: str,
        about: dict[str, str],
        policy: DiskPolicy,
        *,
        in_force: list[Sample],
        kept: Sequence[Sample] = (),
        coded: Callable[[str, Message], Message] = lambda _, message: message,
    ) -> None:
        """Create the first file and start writing.

        Args:
            path: of the file, or what the files' names are made of where the recording is split.
            namespace: of the keys.
            about: what the file says of the recording.
            policy: layout on the disk.
            in_force: latched messages that came before; every file begins with those in force then.
            kept: messages that came before and are written first, all of them, however little may wait.
            coded: what is written in place of a message.

        Raises:
            UsageError: there is a file already, or no folder.
            OSError: the system refuses.
        """
        self.series = FileSeries(path, policy.split)
        self.choice = CompressionChoice(policy.compression)
        self.compression = ""
        self.messages = self.bytes_in = self.safe_ns = 0
        self.full = False
        self.ended = False
        self.words = ""
        self.begun = time.monotonic()
        self._namespace = namespace
        self._about = about
        self._policy = policy
        self._coded = coded
        self._in_force = {(sample.key, sample.writer): sample for sample in in_force}
        self._losses: Counter[str] = Counter()  # of files that are closed
        self._unwritten: Counter[str] = Counter()  # not yet told to a file
        self._written_before = 0
        self._rate = Rate()
        self._queue = deque(kept)
        self._waiting = sum(len(sample.payload) for sample in kept)
        self._room = policy.memory + self._waiting  # what was kept takes none from what comes
        self._changed = threading.Condition()
        self._stopping = False
        self._last_ns = 0
        self._to_sync: tuple[RecordingFile, int] | None = None
        self._file: RecordingFile | None = self._open(kept[0].received_ns if kept else time.time_ns())
        self._thread = threading.Thread(target=self._run, name="disk", daemon=True)
        self._sync_thread = threading.Thread(target=self._sync, name="sync", daemon=True)
        self._thread.start()
        self._sync_thread.start()

    # Called from any thread.

    def put(self, sample: Sample) -> None:
        """Take a message over; returns at once."""
        with self._changed:
            if self.full or self.ended or self._waiting + len(sample.payload) > self._room:
                self._unwritten[sample.key] += 1
                return
            self._waiting += len(sample.payload)
            self._queue.append(sample)
            self._rate.count(len(sample.payload))
            self._changed.notify_all()

    def lose(self, key: str, count: int) -> None:
        """Count messages that were lost before they came here."""
        with self._changed:
            self._unwritten[key] += count

    @property
    def bytes_written(self) -> int:
        """Bytes in all files of the recording."""
        file = self._file
        return self._written_before + (0 if file is None else file.mcap.size)

    @property
    def waiting_bytes(self) -> int:
        """Bytes that wait to be written."""
        return self._waiting

    @property
    def bytes_per_second(self) -> float:
        """How fast messages come in."""
        return self._rate.per_second()[1]

    def losses(self) -> dict[str, int]:
        """Messages by key that came and are in no file, as far as is known."""
        with self._changed:
            total = self._losses + self._unwritten
            if self._file is not None:
                total += Counter(self._file.losses())
        return dict(sorted(total.items()))

    def disk_free(self) -> int:
        """Bytes that are free on the disk."""
        return shutil.disk_usage(self.series.path.parent).free

    def close(self) -> None:
        """Write all that waits, and close the file."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._thread.join()
        self._sync_thread.join()

    # On the disk's thread.

    def _run(self) -> None:
        try:
            self._write_until_stopped()
        except Exception as error:
            log.exception("the recording ends: it cannot be written")
            self.words = f"the recording has ended: {error}"
        finally:
            self._finish()
            with self._changed:
                self.ended = True
                self._changed.notify_all()

    def _write_until_stopped(self) -> None:
        chunk_ends: float | None = None
        while True:
            samples = self._take(chunk_ends)
            for sample in samples:
                self._write(sample)
            now = time.monotonic()
            open_messages = self._file.mcap.open_messages if self._file is not None else 0
            if open_messages and chunk_ends is None:
                chunk_ends = now + _CHUNK_SECONDS
            if not open_messages:
                chunk_ends = None
            elif chunk_ends is not None and now >= chunk_ends:
                self._close_chunk()
                chunk_ends = None
            if self._file is None and not self.ended:
                self._resume()
            if self._over():
                return

    def _over(self) -> bool:
        with self._changed:
            return self._stopping and not self._queue

    def _take(self, until: float | None) -> list[Sample]:
        """What waits, once there is something, until a time (monotonic) or the end."""
        if self._file is None:
            until = time.monotonic() + _LOOK_AGAIN
        with self._changed:
            timeout = None if until is None else max(until - time.monotonic(), 0.0)
            self._changed.wait_for(lambda: self._queue or self._stopping, timeout)
            # Not all at once: a chunk must be closed in time while messages pile up.
            return [self._queue.popleft() for _ in range(min(len(self._queue), 16))]

    def _write(self, sample: Sample) -> None:
        file = self._file
        with self._changed:
            self._waiting -= len(sample.payload)
            if file is None:
                self._unwritten[sample.key] += 1
                return
        row = row_of(sample.key, self._namespace)
        if row is not None and row.delivery is Delivery.LATCHED:
            self._in_force[sample.key, sample.writer] = sample
        try:
            is_full = file.write(sample)
        except OSError as error:  # a new channel is written at once
            file.lose(sample.key)
            self._stop_for(error)
            return
        with self._changed:
            self.messages += 1
            self.bytes_in += len(sample.payload)
        self._last_ns = sample.received_ns
        if is_full:
            self._close_chunk()

    def _close_chunk(self) -> None:
        file = self._file
        if file is None:
            return
        free = self.disk_free()
        size = file.mcap.open_bytes
        if free - size < self._policy.reserve:
            self._make_room(
                f"{free >> 20} MiB are left on the disk, of which {self._policy.reserve >> 20} are kept free"
            )
            return
        compression = self.choice.next(self.bytes_per_second, self._waiting / self._room)
        begun = time.perf_counter()
        try:
            file.mcap.close_chunk(compression)
        except OSError as error:
            self._stop_for(error)
            return
        self.choice.measure(compression, size, time.perf_counter() - begun)
        self.compression = compression
        with self._changed:
            self._to_sync = file, self._last_ns
            self._changed.notify_all()
        if self.series.is_due(file.mcap.size, file.begun):
            self._finish()
            self._resume()

    def _make_room(self, words: str) -> None:
        file = self._file
        if self._policy.on_full is OnFull.OLDEST and file is not None and self.series.drop_oldest():
            log.warning("%s: removed the oldest file", words)
            return
        self._stop(f"disk full: {words}")

    def _stop_for(self, error: OSError) -> None:
        self._stop(f"{self.series.path} cannot be written: {error.strerror or error}")

    def _stop(self, words: str) -> None:
        """Close the file and write no more: for ever, or until there is room."""
        then = {
            OnFull.STOP: "the recording ends here",
            OnFull.WAIT: "it goes on when there is room",
            OnFull.OLDEST: "it goes on when there is room",
        }[self._policy.on_full]
        log.warning("%s; %s", words, then)
        self.words = f"{words}; {then}"
        with self._changed:
            self.full = True
            self.ended = self._policy.on_full is OnFull.STOP
        self._finish()

    def _resume(self) -> None:
        """Begin the next file, where there is room for one."""
        if self.disk_free() < self._policy.reserve + (self._policy.reserve >> 2) and self.full:
            return
        try:
            self._file = self._open(self._last_ns + 1)
        except OSError as error:
            self.words = f"no further file can be begun: {error.strerror or error}"
            with self._changed:
                self.full = True
            return
        if self.full:
            log.info("there is room again: going on in %s", self._file.path)
            self.words = ""
        with self._changed:
            self.full = False

    def _open(self, begin_ns: int) -> RecordingFile:
        file = RecordingFile(self.series.next(), self._namespace, self._about, self._coded)
        try:
            file.begin_with(sorted(self._in_force.values(), key=lambda s: s.received_ns), begin_ns)
        except OSError:
            file.mcap.discard()
            raise
        self.series.begun(file.path)
        self._last_ns = begin_ns
        return file

    def _finish(self) -> None:
        file, self._file = self._file, None
        if file is None:
            return
        with self._changed:
            self._to_sync = None
            unwritten, self._unwritten = self._unwritten, Counter()
        for key, count in unwritten.items():
            file.lose(key, count)
        told = sum(file.losses().values())
        compression = self.choice.next(self.bytes_per_second, 0.0)
        is_whole = True
        try:
            file.finish(compression)
        except OSError as error:
            log.error("%s has no index (%s): zsight bag recover mends it", file.path, error.strerror or error)
            is_whole = False
        losses = file.losses()
        taken_back = sum(losses.values()) - told  # written, as it seemed, in chunks for which there was no room
        with self._changed:
            self._losses.update(losses)
            self.messages -= taken_back
            self._written_before += file.mcap.size
            if is_whole and not taken_back:
                self.safe_ns = max(self.safe_ns, self._last_ns)

    # On the other thread.

    def _sync(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._to_sync is not None or self.ended)
                if self._to_sync is None:
                    return
                (file, last_ns), self._to_sync = self._to_sync, None
            try:
                file.mcap.sync()
            except OSError:  # closed meanwhile, which waits for the disk itself
                continue
            with self._changed:
                self.safe_ns = max(self.safe_ns, last_ns)
