"""All commands in one table; each is imported when it is wanted, so that one is not slower for the others."""

from __future__ import annotations

from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command, get_group

__all__ = ["COMMANDS", "app"]

COMMANDS = {
    "demo": "demonstrate:demo",
    "up": "cells:up",
    "down": "cells:down",
    "run": "running:run",
    "find": "finding:find",
    "segment": "clouds:segment",
    "downsample": "clouds:downsample",
    "plane": "clouds:plane",
    "snapshot": "clouds:snapshot",
    "cloud": "clouds:tools",
    "topic": "topics:app",
    "node": "nodes:app",
    "catalog": "catalog:app",
    "bag": "bag:app",
    "bundle": "bundles:app",
    "param": "parameters:app",
    "view": "viewing:view",
    "keys": "keys:app",
    "doctor": "doctoring:doctor",
    "logs": "logs:logs",
    "why": "explaining:why",
    "calibrate": "explaining:calibrate",
    "warm": "running:warm",
    "bench": "benching:bench",
    "version": "versions:version",
}
"""By name: the module in this package and the function, or the group of commands, that it has there."""

_PASSED_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
_CONTEXT_SETTINGS = {"run": _PASSED_ON}  # what follows belongs to the service


class _Commands(TyperGroup):
    """The table as a group of commands."""

    # Typer brings its own click along, whose types are not public.
    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002  # the signature is click's
        """All names."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002  # the signature is click's
        """The command with a name."""
        module, _, name = COMMANDS.get(cmd_name, "").partition(":")
        if not module:
            return None
        found = getattr(import_module(f"zsight.cli.{module}"), name)
        command = get_group(found) if isinstance(found, typer.Typer) else _alone(cmd_name, found)
        command.name = cmd_name
        return command


def _alone(name: str, function: Any) -> Any:
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(context_settings=_CONTEXT_SETTINGS.get(name))(function)
    return get_command(alone)


app = typer.Typer(
    name="zsight",
    cls=_Commands,
    help="Find objects in point clouds over Eclipse Zenoh, with no ROS.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(asked: bool) -> None:
    if asked:
        from zsight.cli.versions import version

        version()
        raise typer.Exit(0)


@app.callback()
def _options(
    _: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Find objects in point clouds over Eclipse Zenoh, with no ROS."""
