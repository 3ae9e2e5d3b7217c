"""``zsight topic``: what travels, between whom, how fast."""

from __future__ import annotations

import itertools
import time
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, print_table, say
from zsight.errors import DeadlinePassed, NobodyAnswers

if TYPE_CHECKING:
    from zsight.beats import Topic
    from zsight.bus import Bus

__all__ = ["app"]

app = typer.Typer(help="What travels, between whom, how fast.", no_args_is_help=True, rich_markup_mode=None)

Key = Annotated[str, typer.Argument(metavar="KEY", help="A key, such as zsight/kinect/points.")]
Count = Annotated[int, typer.Option("--count", min=1, help="Stop after so many messages.")]
Duration = Annotated[float, typer.Option("--duration", min=0.01, help="Stop after so many seconds.")]


@app.command(name="list")
def list_topics(json: Json = False, connect: Connect = None, namespace: Namespace = None) -> None:
    """All keys that are written or read."""
    topics = _topics(connect, namespace)
    if json:
        print_json({"topics": [_topic_json(topic) for topic in topics]})
        return
    rows = [(t.key, len(t.writers), len(t.readers), _rate(t)) for t in topics]
    print_table(["key", "writers", "readers", "rate"], rows)


@app.command()
def info(key: Key, json: Json = False, connect: Connect = None, namespace: Namespace = None) -> None:
    """Writers and readers of a key, with host, process, rate and losses."""
    found = [topic for topic in _topics(connect, namespace) if topic.key == key]
    if not found:
        raise NobodyAnswers(f"nobody writes or reads {key}; see: zsight topic list")
    if json:
        print_json(_topic_json(found[0]))
        return
    for beat, writer in found[0].writers:
        say(
            f"written by {beat.host}/{beat.process}: {writer.sent} sent, {writer.rate_hz:.1f} Hz, {writer.bytes_per_second / 1e6:.1f} MB/s"
        )
    for beat, reader in found[0].readers:
        age = "never" if reader.age_of_last is None else f"{reader.age_of_last:.2f} s ago"
        say(
            f"read by {beat.host}/{beat.process}: {reader.received} received, {reader.superseded} superseded, {reader.lost} lost, {reader.late} late, {reader.refused} refused, {reader.rate_hz:.1f} Hz, last {age}"
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
            print_json(_shortened(received.message.model_dump(mode="python"))) if json else _print_words(
                received.message
            )
    if not printed:
        raise DeadlinePassed(f"nothing came on {key}")


def _print_words(message: Any) -> None:
    import yaml

    values = _shortened(message.model_dump(mode="python"))
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    typer.echo(f"{text}---")


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
    """How often messages come on a key; they are counted, not decoded."""
    arrivals, _ = _count(key, count, duration, connect, namespace)
    gaps = [(b - a) / 1e6 for (a, _), (b, _) in itertools.pairwise(arrivals)]
    rate = 1e3 * len(gaps) / sum(gaps) if gaps and sum(gaps) > 0 else 0.0
    report = {
        "key": key,
        "messages": len(arrivals),
        "hz": rate,
        "gap_ms_min": min(gaps, default=None),
        "gap_ms_max": max(gaps, default=None),
    }
    print_json(report) if json else say(
        f"{rate:.2f} Hz from {len(arrivals)} messages, gaps {min(gaps, default=0):.1f} to {max(gaps, default=0):.1f} ms"
    )


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
    arrivals, seconds = _count(key, count, duration, connect, namespace)
    total = sum(size for _, size in arrivals)
    bandwidth = total / seconds if seconds else 0.0
    if json:
        print_json({"key": key, "messages": len(arrivals), "bytes": total, "bytes_per_second": bandwidth})
    else:
        say(f"{bandwidth / 1e6:.2f} MB/s, {total / len(arrivals) / 1e6:.3f} MB each, {len(arrivals)} messages")


def _count(
    key: str, count: int, duration: float, connect: str | None, namespace: str | None
) -> tuple[list[tuple[int, int]], float]:
    """Arrival times (ns) and sizes (bytes) of messages on a key, and the seconds they were counted for."""
    import threading

    from zsight.runtime import join
    from zsight_protocol.channels import Delivery

    arrivals: list[tuple[int, int]] = []
    enough = threading.Event()

    def arrived(sample: Any) -> None:
        arrivals.append((time.monotonic_ns(), sample.size))
        if len(arrivals) >= count:
            enough.set()

    with join(network_of(connect, namespace)) as bus:
        started = time.monotonic()
        reader = bus.link.reader(key, Delivery.EVERY, arrived)
        enough.wait(duration)
        seconds = time.monotonic() - started
        reader.close()
    if not arrivals:
        raise DeadlinePassed(f"nothing came on {key} within {duration:g} s; see: zsight topic list")
    return arrivals[:count], seconds


def _topics(connect: str | None, namespace: str | None) -> list[Topic]:
    from zsight.beats import ask_health, topics_of
    from zsight.runtime import join

    with join(network_of(connect, namespace)) as bus:
        _require_company(bus)
        return topics_of(ask_health(bus))


def _require_company(bus: Bus) -> None:
    if not bus.link.alive(bus.cell.alive("*", "*"), 1.0):
        raise NobodyAnswers(f"a router answers, but cell {bus.cell.namespace} is empty: start it with: zsight up")


def _rate(topic: Topic) -> str:
    return f"{sum(writer.rate_hz for _, writer in topic.writers):.1f} Hz"


def _topic_json(topic: Topic) -> dict[str, Any]:
    return {
        "key": topic.key,
        "writers": [{"host": b.host, "process": b.process, **w.model_dump(exclude={"key"})} for b, w in topic.writers],
        "readers": [{"host": b.host, "process": b.process, **r.model_dump(exclude={"key"})} for b, r in topic.readers],
    }
