"""``zsight view``: the browser page, and bridges to other viewers."""

from __future__ import annotations

import math
import os
import sys
import webbrowser
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from zsight.cli.options import Connect, Namespace, network_of, refuse_options
from zsight.cli.output import say
from zsight.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bridge import Sink
    from zsight.network import Network

__all__ = ["view"]


_PORTS = {"page": 8008, "foxglove": 8765}
_RERUN = "rerun+http://127.0.0.1:9876/proxy"


def view(
    context: typer.Context,
    host: Annotated[str, typer.Option("--host", help="Address that is served on.")] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            "--port", min=0, max=65535, help="Port; 0 takes a free one; 8008 if not given, for Foxglove 8765."
        ),
    ] = None,
    read_only: Annotated[bool, typer.Option("--read-only", help="Show, and ask nothing of the cell.")] = False,
    frame: Annotated[str, typer.Option("--frame", help="Fixed frame; the root of the tree if not given.")] = "",
    folder: Annotated[str, typer.Option("--folder", help="Keep snapshots in this folder as well.")] = "",
    browser: Annotated[bool, typer.Option("--open", help="Open the page in this host's browser.")] = False,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="In place of the page serve Foxglove's viewers.")
    ] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="In place of the page show the cell in Rerun.")] = False,
    to: Annotated[
        str, typer.Option("--to", metavar="TARGET", help="With --rerun: its viewer's address, or a .rrd file.")
    ] = _RERUN,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Show a cell in the browser until Ctrl-C: clouds, frames, selections, finds, health; works with nothing running too."""
    network = network_of(connect, namespace)
    if foxglove and rerun:
        raise UsageError("--foxglove and --rerun are two viewers: start one zsight view for each")
    if not rerun:
        refuse_options(context, ("to",), "needs --rerun")
    if foxglove or rerun:
        refuse_options(context, _OF_THE_PAGE, "means nothing with another viewer")
        if browser:
            raise UsageError("--open means nothing with another viewer")
    if foxglove:
        _bridge("foxglove", network, lambda: _foxglove(host, _PORTS["foxglove"] if port is None else port))
    if rerun:
        refuse_options(context, ("host", "port"), "means nothing with --rerun: see --to")
        _bridge("rerun", network, lambda: _rerun(to))
    from zsight.runtime import run_service
    from zsight.services import service
    from zsight.viewer import Settings, open_page
    from zsight.viewer.status import missing_router

    own_port = _PORTS["page"] if port is None else port
    settings = Settings(host=host, port=own_port, read_only=read_only, frame=frame, folder=folder)
    with open_page(settings) as page:
        say(f"the page is at {page.link}")
        page.say(missing_router(network.connect))
        if browser:
            webbrowser.open(page.link)

        def loop(bus: Any, _: Any) -> None:
            page.show(bus)

        code = run_service(service("viewer"), settings, "viewer", network, loop=loop, wait=math.inf)
    _leave(code)


_OF_THE_PAGE = ("read_only", "frame", "folder")


def _bridge(name: str, network: Network, open_sink: Callable[[], Sink]) -> NoReturn:
    """Show the cell in another viewer until Ctrl-C.

    Raises:
        UsageError: what is needed for it is not installed.
    """
    from zsight.bridge import feed
    from zsight.runtime import run_service
    from zsight.services import service
    from zsight.settings import Settings

    try:
        sink = open_sink()
    except ModuleNotFoundError as error:
        words = f"--{name} needs what is not installed here ({error.name}): pip install 'zsight[{name}]'"
        raise UsageError(words) from None

    def loop(bus: Any, _: Any) -> None:
        feed(bus, sink)

    _leave(run_service(service("viewer"), Settings(), name, network, loop=loop, wait=math.inf))


def _foxglove(host: str, port: int) -> Sink:
    from zsight.bridge.foxglove_sink import FoxgloveSink

    sink = FoxgloveSink(host, port)
    say(f"connect Foxglove to {sink.address}")
    return sink


def _rerun(target: str) -> Sink:
    from zsight.bridge.rerun_sink import RerunSink
    from zsight.viewer.settings import Settings

    sink = RerunSink(target, Settings().budget)
    say(f"showing the cell in {target}")
    return sink


def _leave(code: int) -> NoReturn:
    from zsight.shared_memory import leave

    leave()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # as zsight run does: threads of open pages would hold the end up
