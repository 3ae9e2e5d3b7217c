"""What waits is kept as its delivery says, and nothing overtaken is handed out after a stall."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest

from zsight.bus.attachment import Attachment
from zsight.bus.counters import ReadCounter
from zsight.bus.inbox import Arrived, Inbox
from zsight.bus.reader import Reader
from zsight.bus.writer_track import WriterTrack
from zsight_protocol.channels import Delivery
from zsight_protocol.codec import encode
from zsight_protocol.geometry import TransformList

if TYPE_CHECKING:
    from collections.abc import Callable

PERIOD = 33_000_000
WAY = 2_000_000


@dataclass(frozen=True)
class Sample:
    key: str = "cell/kinect/points"
    attachment: bytes = b""
    size: int = 1
    payload: bytes = b"x"
    taken: Callable[[], object] = lambda: None

    def take(self) -> bytes | None:
        self.taken()
        return self.payload


class Line:
    """One writer's messages on their way into an inbox, at times (ns) that the test chooses."""

    def __init__(self, delivery: Delivery) -> None:
        self.counter = ReadCounter("cell/kinect/points")
        self.inbox = Inbox(delivery, self.counter)

    def arrive(self, sequence: int, sent_ns: int, now_ns: int, *, writer: int = 1, key: str = "cell/a") -> None:
        attachment = Attachment(writer, sequence, sent_ns)
        missing = self.counter.arrived(attachment, now_ns)
        self.inbox.put(Arrived(Sample(key), key, None, attachment, now_ns, missing))

    def next(self) -> int | None:
        """Number of the next message; none where it is held, or there is none."""
        arrived, _ = self.inbox.next()
        return arrived.attachment.sequence if arrived is not None and arrived.attachment is not None else None


def test_latest_holds_a_backlog_until_something_fresh_comes() -> None:
    line, now = Line(Delivery.LATEST), time.time_ns()
    line.arrive(1, now - 5 * 10**9 - WAY, now - 5 * 10**9)
    line.arrive(2, now - 5 * 10**9 + PERIOD - WAY, now)  # sent five seconds ago, here only now
    assert line.next() is None
    assert line.inbox.next()[1] is not None, "a held message must be looked at again"
    line.arrive(3, time.time_ns() - WAY, time.time_ns())
    assert line.next() == 3
    assert (line.counter.superseded, line.counter.late) == (2, 1)


def test_latest_hands_out_what_was_held_when_nothing_newer_comes() -> None:
    line, now = Line(Delivery.LATEST), time.time_ns()
    line.arrive(1, now - 10**9, now - 10**9 + WAY)
    line.arrive(2, now - 10**9 + PERIOD, now)
    deadline = time.monotonic() + 5.0
    while (number := line.next()) is None:
        assert time.monotonic() < deadline, "a message is held for ever"
    assert number == 2


def test_a_message_that_came_before_the_reader_stood_still_is_held_too() -> None:
    line, now = Line(Delivery.LATEST), time.time_ns()
    for number in range(1, 4):
        sent = now - 5 * 10**9 + number * PERIOD
        line.arrive(number, sent, sent + WAY)
    assert line.next() is None
    line.arrive(160, time.time_ns() - WAY, time.time_ns())
    assert line.next() == 160


def test_a_slow_writer_is_not_taken_for_a_stall() -> None:
    line, now = Line(Delivery.LATEST), time.time_ns()
    line.arrive(1, now - 1_900_000_000, now - 1_900_000_000 + WAY)
    line.arrive(2, now - 900_000_000, now - 900_000_000 + WAY)  # one a second; this one has waited 0.9 s for its reader
    assert line.next() == 2


@pytest.mark.parametrize("other", ["cell/b", "cell/a"])
def test_a_message_that_was_held_up_is_overtaken_on_its_own_key_alone(other: str) -> None:
    """Held up by 0.2 s, it is handed out; while it is copied, a fresh message comes."""
    counter, now, payload = ReadCounter("cell/*"), time.time_ns(), encode(TransformList(transforms=()))
    reader = Reader(TransformList, Delivery.LATEST, counter, threading.Event(), lambda _: None)
    for number in range(1, 4):
        sent = now - 200_000_000 - (4 - number) * PERIOD
        counter.arrived(Attachment(1, number, sent), sent + WAY)

    def comes(key: str, writer: int, number: int, sent_ns: int, taken: Callable[[], object]) -> None:
        reader.arrived(Sample(key, Attachment(writer, number, sent_ns).pack(), len(payload), payload, taken))

    def fresh() -> None:
        comes(other, 2, 1, time.time_ns(), lambda: None)

    comes("cell/a", 1, 4, now - 200_000_000, fresh)
    keys = [received.key for received in (reader.take(5.0), reader.take(0.0)) if received is not None]
    assert keys == (["cell/a", "cell/b"] if other == "cell/b" else ["cell/a"])
    assert counter.superseded == (other == "cell/a")


@pytest.mark.parametrize("delivery", [Delivery.EVERY, Delivery.LATCHED])
def test_others_are_handed_out_however_old(delivery: Delivery) -> None:
    line, now = Line(delivery), time.time_ns()
    line.arrive(1, now - 10**9, now - 10**9)
    line.arrive(2, now - 10**9 + 1, now)
    assert line.next() == (1 if delivery is Delivery.EVERY else 2)


def test_latched_keeps_one_of_each_writer_and_key() -> None:
    line, now = Line(Delivery.LATCHED), time.time_ns()
    for writer, key in ((1, "cell/a"), (2, "cell/a"), (2, "cell/b"), (1, "cell/a")):
        line.arrive(1, now, now, writer=writer, key=key)
    assert len(line.inbox) == 3
    assert line.counter.superseded == 1


def test_every_drops_the_oldest_when_too_many_wait_and_counts_it() -> None:
    line, now = Line(Delivery.EVERY), time.time_ns()
    for number in range(1, 300):
        line.arrive(number, now, now)
    assert line.counter.lost == 299 - len(line.inbox)
    assert line.next() == 299 - 256 + 1


def test_a_number_that_somebody_made_up_is_no_loss() -> None:
    track = WriterTrack(Attachment(1, 5, 0), 0)
    assert track.arrived(Attachment(1, 5, 0), 0) == 0
    assert track.arrived(Attachment(1, 9, 0), 0) == 3
    assert track.arrived(Attachment(1, 2**63, 0), 0) == 0
    assert track.arrived(Attachment(1, 3, 0), 0) == 0


def test_a_way_that_got_longer_is_no_longer_a_delay_after_a_while() -> None:
    track, way = WriterTrack(Attachment(1, 1, 0), WAY), 100_000_000
    for number in range(2, 1000):
        sent = number * PERIOD
        track.arrived(Attachment(1, number, sent), sent + way)
    last = 999 * PERIOD
    assert track.delay_ns(Attachment(1, 999, last), last + way) == 0


def test_the_memory_of_writers_is_bounded() -> None:
    counter = ReadCounter("cell/kinect/points")
    for writer in range(1000):
        counter.arrived(Attachment(writer, 1, 0), 0)
    assert len(counter._tracks) == 256
