"""All commands in one place."""

from __future__ import annotations

from typing import Annotated

import typer

from zsight.cli import benching, catalog, cells, clouds, demonstrate, explaining, finding, nodes, running, topics

__all__ = ["app"]

app = typer.Typer(
    name="zsight",
    help="Find objects in point clouds over Eclipse Zenoh, with no ROS.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command()(demonstrate.demo)
app.command()(cells.up)
app.command()(cells.down)
app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})(
    running.run
)
app.command()(finding.find)
app.command()(clouds.segment)
app.command()(clouds.downsample)
app.command()(clouds.plane)
app.command()(clouds.snapshot)
app.add_typer(clouds.tools, name="cloud")
app.add_typer(topics.app, name="topic")
app.add_typer(nodes.app, name="node")
app.add_typer(catalog.app, name="catalog")
app.command()(explaining.why)
app.add_typer(explaining.calibrate, name="calibrate")
app.command()(running.warm)
app.command()(benching.bench)


@app.command()
def version() -> None:
    """Print the version."""
    from zsight.runtime import version as of_this

    typer.echo(of_this())


def _print_version(asked: bool) -> None:
    if asked:
        version()
        raise typer.Exit(0)


@app.callback()
def _options(
    _: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Find objects in point clouds over Eclipse Zenoh, with no ROS."""
