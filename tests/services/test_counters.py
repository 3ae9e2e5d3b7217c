"""What health beats tell of rates, delays and losses."""

from __future__ import annotations

import pytest

from zsight.bus import counters
from zsight.bus.attachment import Attachment
from zsight.bus.counters import Rate, ReadCounter, Stopwatch, WriteCounter

MS = 1_000_000


class Clock:
    """A clock that the test moves."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return round(self.now * 1e9)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(counters, "time", clock)
    return clock


def test_a_rate_is_that_of_the_last_seconds(clock: Clock) -> None:
    rate = Rate()
    assert rate.per_second() == (0.0, 0.0)
    for _ in range(100):
        rate.count(50)
        clock.now += 0.1
    assert rate.per_second() == pytest.approx((10, 500))
    for _ in range(100):
        rate.count(10)
        clock.now += 0.05
    assert rate.per_second() == pytest.approx((20, 200))
    clock.now += 10
    assert rate.per_second() == (0.0, 0.0)


def test_one_message_is_no_rate(clock: Clock) -> None:
    rate = Rate()
    rate.count(50)
    assert rate.per_second() == (0.0, 0.0)
    rate.count(50)  # at the same instant
    assert clock.now == 100.0
    assert rate.per_second() == (0.0, 0.0)


def test_a_stopwatch_tells_the_middle_and_the_worst() -> None:
    watch = Stopwatch()
    assert watch.latency() is None
    for milliseconds in range(101):
        watch.count(milliseconds * MS)
    latency = watch.latency()
    assert latency is not None
    assert (latency.p50_ms, latency.p99_ms, latency.max_ms) == (50, 99, 100)
    for _ in range(256):
        watch.count(-2 * MS)  # hosts' clocks may differ
    latency = watch.latency()
    assert latency is not None
    assert (latency.p50_ms, latency.max_ms) == (-2, -2)


def test_a_writer_tells_what_it_sent(clock: Clock) -> None:
    counter = WriteCounter("cell/kinect/points")
    assert counter.health().since_stamp is None
    for _ in range(10):
        counter.count(1000, since_stamp_ns=3 * MS)
        clock.now += 0.5
    health = counter.health()
    assert (health.key, health.sent) == ("cell/kinect/points", 10)
    assert health.rate_hz == pytest.approx(2)
    assert health.bytes_per_second == pytest.approx(2000)
    assert health.since_stamp is not None
    assert health.since_stamp.p50_ms == 3


def test_a_reader_tells_every_fate_apart(clock: Clock) -> None:
    counter = ReadCounter("cell/kinect/points")
    for sequence in (4, 5, 8):
        counter.arrived(Attachment(1, sequence, clock.time_ns()), clock.time_ns())
        clock.now += 0.5
    counter.taken(
        1000, received_ns=clock.time_ns(), sent_ns=clock.time_ns() - 2 * MS, stamp_ns=clock.time_ns() - 9 * MS
    )
    counter.refused += 1
    counter.superseded += 1
    clock.now += 0.25
    health = counter.health()
    assert (health.received, health.superseded, health.lost, health.late, health.refused) == (1, 1, 2, 0, 1)
    assert health.age_of_last == pytest.approx(0.25)
    assert health.on_the_way is not None
    assert health.since_stamp is not None
    assert [health.on_the_way.p50_ms, health.since_stamp.p50_ms] == pytest.approx([2, 9])


def test_a_reader_that_read_nothing_has_no_age() -> None:
    health = ReadCounter("cell/kinect/points").health()
    assert (health.age_of_last, health.on_the_way, health.rate_hz) == (None, None, 0.0)


def test_two_writers_are_counted_apart(clock: Clock) -> None:
    counter = ReadCounter("cell/tf")
    for writer, sequence in ((1, 1), (2, 100), (1, 2), (2, 101), (2, 103)):
        counter.arrived(Attachment(writer, sequence, clock.time_ns()), clock.time_ns())
    assert counter.lost == 1


def test_late_is_slower_than_the_writers_fastest_whatever_the_clocks(clock: Clock) -> None:
    counter = ReadCounter("cell/kinect/points")
    hour = 3_600_000 * MS  # the writer's clock is an hour behind
    for sequence, way in enumerate((5, 3, 20, 54, 52), start=1):
        sent = clock.time_ns() - hour
        counter.arrived(Attachment(1, sequence, sent), clock.time_ns() + way * MS)
        clock.now += 0.1
    assert counter.late == 1


@pytest.mark.parametrize("data", [b"", b"x" * 23, b"x" * 25])
def test_an_attachment_of_another_length_is_none(data: bytes) -> None:
    assert Attachment.unpack(data) is None


def test_an_attachment_comes_back() -> None:
    attachment = Attachment(2**64 - 1, 1, 1_700_000_000_000_000_000)
    assert Attachment.unpack(attachment.pack()) == attachment
