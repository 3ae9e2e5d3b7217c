"""``zsight bundle``: one answer with all that it was made of, in one small file."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, say
from zsight.errors import DeadlinePassed, UsageError

if TYPE_CHECKING:
    from zsight.network import Network

__all__ = ["app"]

app = typer.Typer(
    help="One answer with all that it was made of, in one file.", no_args_is_help=True, rich_markup_mode=None
)

_PATIENCE = 60.0  # seconds; a recorder goes on for a while after it was triggered


@app.callback()
def _group() -> None:
    """One answer with all that it was made of, in one file."""


@app.command()
def last(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The new file.")],
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="A recording; left out: what the cell's recorder has in memory."),
    ] = None,
    goal: Annotated[str, typer.Option("--goal", metavar="ID", help="The answer to this goal.")] = "",
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """The last answer: cloud, transforms, catalogue, settings, goal, result, versions.

    Without --from a recorder of the cell must keep the last seconds in memory: zsight run recorder --ring 20.
    """
    from zsight.recording.bundle import bundle

    if output.exists():  # before the recorder gives away what it keeps in memory
        raise UsageError(f"{output} is there already: choose another name, or remove it first")
    network = network_of(connect, namespace)
    report = bundle(source or _triggered(network), output, goal, network.namespace)
    if json:
        print_json(report)
    else:
        words = f"{report['object_type']}, {report['status']}, {report['messages']} messages, {report['size']} bytes"
        say(f"{output}: {words}")


def _triggered(network: Network) -> Path:
    """The file that the cell's recorder writes when it is triggered now."""
    from zsight.recording_client import RecorderClient
    from zsight.runtime import join

    with join(network) as bus:
        triggered = RecorderClient(bus).trigger()
        recorder, path = RecorderClient(bus, triggered.recorder), Path(triggered.path)
        pause, deadline = threading.Event(), time.monotonic() + _PATIENCE
        while recorder.status().state.value == "recording":
            if time.monotonic() > deadline:
                raise DeadlinePassed(f"{path} is still being recorded after {_PATIENCE:g} s")
            pause.wait(0.1)
    if not path.is_file():
        raise UsageError(f"the recorder wrote {path} on its own host: copy it here and give it with --from")
    return path
