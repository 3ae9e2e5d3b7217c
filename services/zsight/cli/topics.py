"""``zsight topic``: what travels, between whom, how fast."""

from __future__ import annotations

import itertools
import statistics
import threading
import time
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, print_table, say
from zsight.errors import DeadlinePassed, NobodyAnswers

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from zsight.bus import Bus, RawSample
    from zsight.bus.attachment import Attachment
    from zsight.hosts.beats import Topic
    from zsight_protocol.health import Health, Latency
    from zsight_protocol.message import Message
    from zsight_protocol.point_cloud import PointCloud2

__all__ = ["app"]

app = typer.Typer(help="What travels, between whom, how fast.", no_args_is_help=True, rich_markup_mode=None)

_WORD = 1.0  # seconds between two words of a measurement that goes on

_NO_RATE = "one message has no rate"

_LOOK = 1.0  # seconds between two looks at who is there

Key = Annotated[str, typer.Argument(metavar="KEY", help="A key, such as zsight/kinect/points.")]
Count = Annotated[int, typer.Option("--count", min=1, help="Stop after so many messages.")]
Duration = Annotated[float, typer.Option("--duration", min=0.01, help="Stop after so many seconds.")]
Looks = Annotated[
    int | None, typer.Option("--count", min=1, help="Look so many times, once a second; once if not given.")
]
LookingTime = Annotated[float | None, typer.Option("--duration", min=0.01, help="Go on looking for so many seconds.")]


@app.command(name="list")
def list_topics(
    count: Looks = None,
    duration: LookingTime = None,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """All keys that are written or read."""
    for topics in _looks(count, duration, connect, namespace):
        if json:
            print_json({"topics": [_topic_json(topic) for topic in topics]})
            continue
        rows = [(t.key, _names(t.writers), _names(t.readers), _rate(t), _missed(t)) for t in topics]
        print_table(["key", "writers", "readers", "rate", "lost"], rows)


@app.command()
def info(
    key: Key,
    count: Looks = None,
    duration: LookingTime = None,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Writers and readers of a key, with host, process, rate, losses, and how long each stage takes."""
    for topics in _looks(count, duration, connect, namespace):
        found = next((topic for topic in topics if topic.key == key), None)
        if found is None:
            raise NobodyAnswers(f"nobody writes or reads {key}; see: zsight topic list")
        print_json(_topic_json(found)) if json else _say_topic(found)


def _say_topic(topic: Topic) -> None:
    for beat, writer in topic.writers:
        say(
            f"written by {beat.host}/{beat.process}: {writer.sent} sent, {writer.rate_hz:.1f} Hz, {writer.bytes_per_second / 1e6:.1f} MB/s{_stage('sent', writer.since_stamp)}"
        )
    for beat, reader in topic.readers:
        age = "never" if reader.age_of_last is None else f"{reader.age_of_last:.2f} s ago"
        say(
            f"read by {beat.host}/{beat.process}: {reader.received} received, {reader.superseded} superseded, {reader.lost} lost, {reader.late} late, {reader.refused} refused, {reader.rate_hz:.1f} Hz, last {age}{_stage('on the way', reader.on_the_way, since='')}{_stage('decoded', reader.since_stamp)}"
        )


@app.command()
def echo(
    key: Key,
    count: Annotated[int | None, typer.Option("--count", min=1, help="Stop after so many messages.")] = None,
    duration: Annotated[float | None, typer.Option("--duration", min=0.01, help="Stop after so many seconds.")] = None,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Print messages as they come, long arrays shortened."""
    from zsight.runtime import join
    from zsight_protocol.channels import channel_of

    network = network_of(connect, namespace)
    kind = channel_of(key, network.namespace).message
    if kind is None:
        raise NobodyAnswers(f"{key} carries no messages")
    deadline = None if duration is None else time.monotonic() + duration
    with join(network) as bus:
        reader = bus.reader(key, kind)
        printed = 0
        while count is None or printed < count:
            received = reader.take(None if deadline is None else max(deadline - time.monotonic(), 0))
            if received is None:
                break
            printed += 1
            print_json(_told(received.message)) if json else _print_words(received.message)
    if not printed:
        raise DeadlinePassed(f"nothing came on {key}")


def _print_words(message: Message) -> None:
    import yaml

    text = yaml.safe_dump(_told(message), sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    typer.echo(f"{text}---")


def _told(message: Message) -> dict[str, Any]:
    """A message as it is printed; a cloud with a summary of its points."""
    from zsight_protocol.point_cloud import PointCloud2

    told: dict[str, Any] = _shortened(message.model_dump(mode="python"))
    return told | {"summary": _summary(message)} if isinstance(message, PointCloud2) else told


def _summary(cloud: PointCloud2) -> dict[str, Any]:
    """How many points were measured, and between which corners they lie (metres)."""
    import numpy as np

    from zsight.convert import points_of

    points = points_of(cloud)
    if any(axis not in (points.dtype.names or ()) for axis in "xyz"):
        return {"points": points.size}
    axes = [points[axis] for axis in "xyz"]
    measured = np.isfinite(axes).all(axis=0)
    corners = {
        name: [round(float(corner(axis[measured])), 4) for axis in axes] if measured.any() else None
        for name, corner in (("low", np.min), ("high", np.max))
    }
    return {"points": points.size, "measured": int(measured.sum()), **corners}


def _shortened(value: Any) -> Any:
    """Arrays with their first few entries and their length; blobs with their length alone."""
    if isinstance(value, dict):
        return {key: _shortened(entry) for key, entry in value.items()}
    if isinstance(value, bytes | bytearray | memoryview):
        return f"<{len(value)} bytes>"
    if isinstance(value, list | tuple):
        short = [_shortened(entry) for entry in value[:12]]
        return [*short, f"... {len(value)} in all"] if len(value) > 12 else short
    if isinstance(value, Enum):
        return value.name.lower()
    return value if isinstance(value, str | int | float | bool | None) else str(value)


@app.command()
def hz(
    key: Key,
    count: Count = 1000000,
    duration: Duration = 5.0,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """How often messages come on a key; they are counted, not decoded, and neither slow nor fill anything."""
    seen = _count(key, count, duration, connect, namespace)
    gaps = [(b - a) / 1e6 for a, b in itertools.pairwise(seen.times)]
    rate = 1e3 * len(gaps) / sum(gaps) if sum(gaps) > 0 else None
    report = {
        "key": key,
        "messages": len(seen.times),
        "lost": seen.lost,
        "hz": rate,
        "gap_ms_min": min(gaps, default=None),
        "gap_ms_max": max(gaps, default=None),
        "gap_ms_deviation": statistics.pstdev(gaps) if gaps else None,
        "on_the_way_ms": statistics.median(seen.on_the_way) if seen.on_the_way else None,
    }
    told = _NO_RATE if rate is None else f"{rate:.2f} Hz from {len(seen.times)} messages"
    words = f"{told}, {seen.lost} lost"
    if gaps:
        words += f", gaps {min(gaps):.1f} to {max(gaps):.1f} ms (deviation {statistics.pstdev(gaps):.1f})"
    print_json(report) if json else say(words)


@app.command()
def bw(
    key: Key,
    count: Count = 1000000,
    duration: Duration = 5.0,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """How many bytes come on a key; they are counted, not decoded."""
    seen = _count(key, count, duration, connect, namespace)
    # Of n messages the n - 1 gaps between them are known.
    seconds = (seen.times[-1] - seen.times[0]) / 1e9
    bandwidth = sum(seen.sizes[1:]) / seconds if seconds > 0 else None
    total, messages = sum(seen.sizes), len(seen.times)
    if json:
        print_json({"key": key, "messages": messages, "lost": seen.lost, "bytes": total, "bytes_per_second": bandwidth})
    else:
        told = _NO_RATE if bandwidth is None else f"{bandwidth / 1e6:.2f} MB/s"
        say(f"{told}, {total / messages / 1e6:.3f} MB each, {messages} messages, {seen.lost} lost")


@dataclass
class _Seen:
    """Of the messages on a key: when each came (ns), its bytes, milliseconds on the way, and how many are missing."""

    times: list[int] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    on_the_way: list[float] = field(default_factory=list)
    lost: int = 0

    def add(self, size: int, attachment: Attachment | None, missing: int) -> None:
        self.times.append(time.monotonic_ns())
        self.sizes.append(size)
        self.lost += missing
        if attachment is not None:
            self.on_the_way.append((time.time_ns() - attachment.sent_ns) / 1e6)


def _count(key: str, count: int, duration: float, connect: str | None, namespace: str | None) -> _Seen:
    """What comes on a key, by its sizes and attachments alone: no payload is copied out or decoded."""
    from zsight.bus.attachment import Attachment
    from zsight.bus.counters import ReadCounter
    from zsight.runtime import join
    from zsight_protocol.channels import Delivery

    seen, counter, enough = _Seen(), ReadCounter(key), threading.Event()

    def arrived(sample: RawSample) -> None:
        if enough.is_set():
            return
        attachment = Attachment.unpack(sample.attachment)
        seen.add(sample.size, attachment, counter.arrived(attachment, time.time_ns()))
        if len(seen.times) >= count:
            enough.set()

    with join(network_of(connect, namespace)) as bus:
        reader = bus.link.reader(key, Delivery.LATEST, arrived)
        end = time.monotonic() + duration
        while not enough.wait(min(max(end - time.monotonic(), 0), _WORD)) and time.monotonic() < end:
            say(f"{len(seen.times)} messages so far")
        enough.set()
        reader.close()
    if not seen.times:
        raise DeadlinePassed(f"nothing came on {key} within {duration:g} s; see: zsight topic list")
    return seen


def _looks(
    count: int | None, duration: float | None, connect: str | None, namespace: str | None
) -> Iterator[list[Topic]]:
    """What is written and read, again and again: so often, or so long, or once."""
    from zsight.hosts.beats import ask_health, topics_of
    from zsight.runtime import join

    most = 1 if count is None and duration is None else count
    with join(network_of(connect, namespace)) as bus:
        _require_company(bus)
        start = time.monotonic()
        for look in itertools.count():
            due = start + look * _LOOK
            if look == most or (duration is not None and due > start + duration):
                return
            bus.stopping.wait(max(due - time.monotonic(), 0.0))
            yield topics_of(ask_health(bus))


def _require_company(bus: Bus) -> None:
    if not bus.link.alive(bus.cell.alive("*", "*"), 1.0):
        raise NobodyAnswers(f"a router answers, but cell {bus.cell.namespace} is empty: start it with: zsight up")


def _stage(what: str, latency: Latency | None, since: str = " after the stamp") -> str:
    """Median and 99th percentile of a stage."""
    return "" if latency is None else f"; {what} {latency.p50_ms:.1f} / {latency.p99_ms:.1f} ms{since}"


def _names(ends: Sequence[tuple[Health, object]]) -> str:
    return ", ".join(f"{beat.host}/{beat.process}" for beat, _ in ends) or "-"


def _missed(topic: Topic) -> str:
    """What all readers together lost or refused."""
    return str(sum(reader.lost + reader.refused for _, reader in topic.readers))


def _rate(topic: Topic) -> str:
    return f"{sum(writer.rate_hz for _, writer in topic.writers):.1f} Hz"


def _topic_json(topic: Topic) -> dict[str, Any]:
    return {
        "key": topic.key,
        "writers": [{"host": b.host, "process": b.process, **w.model_dump(exclude={"key"})} for b, w in topic.writers],
        "readers": [{"host": b.host, "process": b.process, **r.model_dump(exclude={"key"})} for b, r in topic.readers],
    }
