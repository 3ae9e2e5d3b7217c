"""``zsight version``."""

from __future__ import annotations

import typer

__all__ = ["version"]


def version() -> None:
    """Print the version."""
    from zsight.runtime import version as of_this

    typer.echo(of_this())
