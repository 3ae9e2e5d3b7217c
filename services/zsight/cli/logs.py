"""``zsight logs``: what the processes of all hosts say."""

from __future__ import annotations

import logging
from datetime import datetime
from typing import TYPE_CHECKING, Annotated

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight.bus import Bus
    from zsight_protocol.log_event import LogEvent

__all__ = ["logs"]


def logs(
    process: Annotated[
        str, typer.Argument(metavar="[PROCESS]", help="Name of a process, or HOST/NAME; else all.")
    ] = "*",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on as events come.")] = False,
    level: Annotated[str, typer.Option("--level", help="Least severity: DEBUG, INFO, WARNING or ERROR.")] = "DEBUG",
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """The last events of every process, oldest first; with --json one object a line."""
    from zsight.errors import NobodyAnswers, UsageError
    from zsight.runtime import join

    levels = logging.getLevelNamesMapping()
    if level.upper() not in levels:
        raise UsageError(f"level is {level!r}; expected DEBUG, INFO, WARNING or ERROR")
    host, _, name = process.rpartition("/")
    with join(network_of(connect, namespace)) as bus:
        heard = False
        for event in _events(bus, host or "*", name, follow=follow):
            heard = True
            if levels.get(event.severity, 0) >= levels[level.upper()]:
                _print(event, as_json=json)
        if not heard and name != "*" and not _is_there(bus, host, name):
            raise NobodyAnswers(f"no process {process} is there; see: zsight node list")


def _is_there(bus: Bus, host: str, process: str) -> bool:
    """Whether a process that tells no events is there; without a host on any."""
    from zsight.hosts.beats import ask_health

    return any(beat.process == process and host in ("", beat.host) for beat in ask_health(bus))


def _events(bus: Bus, host: str, process: str, *, follow: bool) -> Iterator[LogEvent]:
    """What was said; then, where asked, what is being said, without gap or repetition."""
    from zsight.log_book import ask_logs
    from zsight_protocol.channels import Delivery
    from zsight_protocol.log_event import LogEvent

    reader = bus.reader(bus.cell.log(host, process), LogEvent, delivery=Delivery.EVERY) if follow else None
    told: set[tuple[str, str, int, int]] = set()
    for event in ask_logs(bus, host, process):
        told.add(_mark(event))
        yield event
    for event in reader or ():
        if _mark(event) not in told:
            yield event


def _mark(event: LogEvent) -> tuple[str, str, int, int]:
    return event.host, event.process, event.number, event.header.stamp.ns


def _print(event: LogEvent, *, as_json: bool) -> None:
    if as_json:
        print_json({**event.model_dump(mode="json", exclude={"header"}), "stamp_ns": event.header.stamp.ns})
        return
    at = datetime.fromtimestamp(event.header.stamp.ns / 1e9).astimezone().strftime("%H:%M:%S.%f")[:-3]
    typer.echo(f"{at} {event.severity:7} {event.host}/{event.process}: {event.text}")
