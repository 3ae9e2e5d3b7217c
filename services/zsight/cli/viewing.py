"""``zsight view``: the browser page."""

from __future__ import annotations

import math
import os
import sys
import webbrowser
from typing import Annotated, Any

import typer

from zsight.cli.options import Connect, Namespace, network_of
from zsight.cli.output import say

__all__ = ["view"]


def view(
    host: Annotated[str, typer.Option("--host", help="Address the page is served on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="Port of the page; 0 takes a free one.")] = 8008,
    read_only: Annotated[bool, typer.Option("--read-only", help="Show, and ask nothing of the cell.")] = False,
    frame: Annotated[str, typer.Option("--frame", help="Fixed frame; the root of the tree if not given.")] = "",
    folder: Annotated[str, typer.Option("--folder", help="Keep snapshots in this folder as well.")] = "",
    browser: Annotated[bool, typer.Option("--open", help="Open the page in this host's browser.")] = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Show a cell in the browser until Ctrl-C: clouds, frames, selections, finds, health; works with nothing running too."""
    from zsight.runtime import run_service
    from zsight.services import service
    from zsight.shared_memory import leave
    from zsight.viewer import Settings, open_page
    from zsight.viewer.status import missing_router

    settings = Settings(host=host, port=port, read_only=read_only, frame=frame, folder=folder)
    network = network_of(connect, namespace)
    with open_page(settings) as page:
        say(f"the page is at {page.link}")
        page.say(missing_router(network.connect))
        if browser:
            webbrowser.open(page.link)

        def loop(bus: Any, _: Any) -> None:
            page.show(bus)

        code = run_service(service("viewer"), settings, "viewer", network, loop=loop, wait=math.inf)
    leave()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # as zsight run does: threads of open pages would hold the end up
