"""``zsight node``: who is there and how they are."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, print_table, say
from zsight.errors import NobodyAnswers

if TYPE_CHECKING:
    from zsight_protocol.health import Health
    from zsight_protocol.host_report import HostReport

__all__ = ["app"]

app = typer.Typer(help="Who is there and how they are.", no_args_is_help=True, rich_markup_mode=None)


@app.command(name="list")
def list_nodes(json: Json = False, connect: Connect = None, namespace: Namespace = None) -> None:
    """All processes of the cell."""
    beats = _beats(connect, namespace)
    if json:
        print_json({"nodes": [_node_json(beat) for beat in beats]})
        return
    rows = [
        (
            f"{b.host}/{b.process}",
            b.service,
            b.pid,
            _since(b),
            b.level.name,
            f"{b.memory_bytes / 2**20:.0f} MiB",
            b.last_error,
        )
        for b in beats
    ]
    print_table(["process", "service", "pid", "up", "level", "memory", "last error"], rows)


@app.command()
def info(
    process: Annotated[str, typer.Argument(help="Name of a process, or HOST/NAME.")],
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """All that a process tells of itself, and its supervisor of how it ended the last time."""
    beats, hosts = _beats_and_hosts(connect, namespace)
    found = [b for b in beats if process in (b.process, f"{b.host}/{b.process}")]
    crashes = _crashes(hosts, process)
    if not found and crashes and not json:
        say("\n".join(words for lines in crashes.values() for words in lines))
    if not found:
        raise NobodyAnswers(f"no process {process} is there; see: zsight node list")
    for beat in found:
        if json:
            print_json({**_node_json(beat), "supervised": _supervised_json(hosts, beat)})
            continue
        say(
            f"{beat.host}/{beat.process}: service {beat.service} {beat.version}, pid {beat.pid}, up {_since(beat)}, {beat.level.name}"
        )
        for writer in beat.writers:
            say(
                f"  writes {writer.key}: {writer.sent} sent, {writer.rate_hz:.1f} Hz, {writer.bytes_per_second / 1e6:.1f} MB/s"
            )
        for reader in beat.readers:
            say(
                f"  reads {reader.key}: {reader.received} received, {reader.superseded} superseded, {reader.lost} lost, {reader.late} late, {reader.refused} refused, {reader.rate_hz:.1f} Hz"
            )
        if beat.errors:
            say(f"  {beat.errors} warnings or errors, the last: {beat.last_error}")
        for words in crashes.get(f"{beat.host}/{beat.process}", []):
            say(words)


@app.command()
def clocks(json: Json = False, connect: Connect = None, namespace: Namespace = None) -> None:
    """How far the clock of every host is from this one's; exit code 1 where one is more than 20 ms off."""
    from zsight.hosts.clocks import ask_clocks
    from zsight.runtime import join

    network = network_of(connect, namespace)
    with join(network) as bus:
        found = ask_clocks(bus)
    if not found:
        raise NobodyAnswers(f"a router answers, but cell {network.namespace} is empty: start it with: zsight up")
    if json:
        print_json({"clocks": [{"host": c.host, "offset": c.offset, "uncertainty": c.uncertainty} for c in found]})
    else:
        rows = [(c.host, f"{c.offset * 1e3:+.1f} ms", f"{c.uncertainty * 1e3:.1f} ms", c.warning) for c in found]
        print_table(["host", "ahead by", "known to", ""], rows)
    raise typer.Exit(1 if any(clock.warning for clock in found) else 0)


def _beats(connect: str | None, namespace: str | None) -> list[Health]:
    return _beats_and_hosts(connect, namespace)[0]


def _beats_and_hosts(connect: str | None, namespace: str | None) -> tuple[list[Health], list[HostReport]]:
    from zsight.hosts.beats import ask_health
    from zsight.hosts.reports import ask_hosts
    from zsight.runtime import join

    network = network_of(connect, namespace)
    with join(network) as bus:
        beats, hosts = ask_health(bus), ask_hosts(bus)
    if not beats:
        raise NobodyAnswers(f"a router answers, but cell {network.namespace} is empty: start it with: zsight up")
    return beats, hosts


def _crashes(hosts: list[HostReport], process: str) -> dict[str, list[str]]:
    """Lines about how the processes of this name ended the last time, where they did."""
    told: dict[str, list[str]] = {}
    for report in hosts:
        for one in report.processes:
            whole = f"{report.host}/{one.process}"
            if one.crash is not None and process in (one.process, whole):
                ago = max(time.time() - one.crash.stamp.ns / 1e9, 0)
                head = f"  {whole} is {one.state}, started {one.starts} times; it ended {ago:.0f} s ago: {one.crash.reason}"
                told[whole] = [head, *(f"    {line}" for line in one.crash.last_words)]
    return told


def _supervised_json(hosts: list[HostReport], beat: Health) -> dict[str, Any] | None:
    """What the supervisor of a process says of it; none where it has none."""
    for report in hosts:
        for one in report.processes:
            if (report.host, one.process) == (beat.host, beat.process):
                return one.model_dump(mode="json")
    return None


def _since(beat: Health) -> str:
    seconds = max(time.time() - beat.started.ns / 1e9, 0)
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def _node_json(beat: Health) -> dict[str, Any]:
    return {**beat.model_dump(mode="json"), "level": beat.level.name.lower(), "alive": True}
