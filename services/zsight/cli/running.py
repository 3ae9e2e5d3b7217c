"""``zsight run``: one service in this process. ``zsight warm``: compile the kernels once."""

from __future__ import annotations

import gc
import os
import sys
from dataclasses import replace
from typing import Annotated

import typer

from zsight.cli.options import Connect, Namespace, Open, network_of
from zsight.cli.output import print_table, say
from zsight.errors import UsageError
from zsight.network import endpoints_given, endpoints_of

__all__ = ["require_warm", "run", "warm"]


def run(
    context: typer.Context,
    service: Annotated[str, typer.Argument(help="router, camera, voxel, planes, finder, ...")] = "",
    process: Annotated[str | None, typer.Option("--process", help="Name of the process in the keys.")] = None,
    connect: Connect = None,
    namespace: Namespace = None,
    listen: Annotated[str | None, typer.Option("--listen", help="Where a router listens (comma between).")] = None,
    peers: Annotated[str | None, typer.Option("--peers", help="Routers of other sites that it joins.")] = None,
    everybody: Open = False,
) -> None:
    """Run one service here until Ctrl-C; its settings follow as options (zsight run SERVICE --help lists them)."""
    gc.disable()  # until the service is ready: nothing of what it imports will ever be garbage
    from zsight.parameters import load
    from zsight.services import SERVICES
    from zsight.services import service as find_service

    if service in ("", "-h", "--help"):
        print_table(["service", "does"], [(row.name, row.does) for row in SERVICES])
        say("\nzsight run SERVICE --help lists its settings")
        raise typer.Exit(0 if service else 2)
    row = find_service(service)
    if {"-h", "--help"} & set(context.args):
        _describe(row.name)
        raise typer.Exit(0)
    network = network_of(connect, namespace)
    settings = load(row.settings(), process or row.name, network.namespace, _options(context.args))
    if listen is not None:
        network = replace(network, listen=endpoints_given(listen, "--listen"))
    network = replace(network, peers=endpoints_of(peers or ""), open=network.open or everybody)
    from zsight.runtime import run_service
    from zsight.shared_memory import leave

    code = run_service(row, settings, process or row.name, network)
    leave()
    # All is closed by now; taking an interpreter full of compiled kernels apart would cost most of a second more.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _describe(name: str) -> None:
    from zsight.services import service as find_service
    from zsight.settings import describe

    row = find_service(name)
    say(f"zsight run {name}: {row.does}\n")
    settings = [(f"--{option}", default, words) for option, default, words in describe(row.settings())]
    print_table(["setting", "default", ""], settings)


def _options(arguments: list[str]) -> dict[str, str]:
    """Pairs of ``--name value`` or ``--name=value``; a name alone is true."""
    values: dict[str, str] = {}
    rest = list(arguments)
    while rest:
        name = rest.pop(0)
        if not name.startswith("--"):
            raise UsageError(f"got {name!r}; expected a setting as --name value")
        name, equals, value = name[2:].partition("=")
        if not equals:
            value = rest.pop(0) if rest and not rest[0].startswith("--") else "true"
        values[name] = value
    return values


def warm() -> None:
    """Compile the kernels, once a machine, so that services answer at once."""
    require_warm()
    say("kernels are compiled")


def require_warm() -> None:
    """Compile the kernels unless that was done, with a bar for people to see."""
    from zsight_core.warm import is_warm
    from zsight_core.warm import warm as warm_kernels

    if is_warm():
        return
    say("compiling the kernels, once a machine: about a minute")
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    console = Console(stderr=True)
    with Progress(
        TextColumn("compiling kernels"), BarColumn(), TextColumn("{task.description}"), console=console
    ) as bar:
        task = bar.add_task("", total=1.0)
        warm_kernels(lambda what, fraction: bar.update(task, completed=fraction, description=what))
