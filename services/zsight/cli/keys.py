"""``zsight keys``: who may join, and as what."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zsight.cli.options import Json
from zsight.cli.output import print_json, print_table, say
from zsight_protocol.channels import DEFAULT_NAMESPACE

if TYPE_CHECKING:
    from zsight.keys.authority import Authority

__all__ = ["app"]

app = typer.Typer(help="Keys: who may join, and as what.", no_args_is_help=True, rich_markup_mode=None)

Folder = Annotated[
    Path, typer.Option("--folder", metavar="DIR", help="Folder of the authority: keep it on the router's host.")
]
Host = Annotated[str, typer.Argument(metavar="HOST", help="Name of the host in keys.")]
Days = Annotated[int, typer.Option("--days", min=0, max=3650, help="How long the certificate is good.")]
Cells = Annotated[list[str] | None, typer.Option("--cell", help="Namespace that it belongs to; may be given again.")]

_FOLDER = Path("zsight-keys")


@app.command()
def init(
    router: Annotated[list[str], typer.Argument(metavar="ROUTER...", help="Names and addresses of the router's host.")],
    folder: Folder = _FOLDER,
    cell: Cells = None,
    days: Days = 825,
) -> None:
    """Make an authority and the keys of its router."""
    place = _authority(folder).init(router, days=days, cell=(cell or [DEFAULT_NAMESPACE])[0])
    say(
        f"authority in {folder}; start the router with: ZSIGHT_KEYS={place} zsight run router --listen tls/0.0.0.0:7447"
    )
    say("add hosts with: zsight keys add HOST --role camera")


@app.command()
def add(
    hosts: Annotated[list[str], typer.Argument(metavar="HOST...", help="Names of hosts in keys.")],
    role: Annotated[
        list[str] | None,
        typer.Option(
            "--role",
            help="What it runs: a service's name, client or operator; may be given again; its own name if left out.",
        ),
    ] = None,
    folder: Folder = _FOLDER,
    cell: Cells = None,
    days: Days = 825,
) -> None:
    """Make the keys of hosts; a running router takes them at once."""
    for host in hosts:
        place = _authority(folder).add(host, role or [host], days=days, cells=cell or [DEFAULT_NAMESPACE])
        say(f"keys of {host} in {place}: copy that folder there, by a safe way, and set ZSIGHT_KEYS to it")


@app.command()
def revoke(host: Host, folder: Folder = _FOLDER) -> None:
    """Let a running router refuse a host from now on."""
    _authority(folder).revoke(host)
    say(f"{host} is refused from now on")


@app.command(name="list")
def list_hosts(folder: Folder = _FOLDER, json: Json = False) -> None:
    """Hosts that may join, their roles, and when their certificates end."""
    from zsight.keys.authority import expiry
    from zsight.keys.identity import CERTIFICATE

    hosts = _authority(folder).hosts()
    ends = {host.host: expiry(folder / host.host / CERTIFICATE) for host in hosts}
    if json:
        rows = [
            {"host": h.host, "roles": h.roles, "cells": h.cells, "expires": ends[h.host].isoformat()} for h in hosts
        ]
        print_json({"hosts": rows})
        return
    print_table(
        ["host", "roles", "cells", "good until"],
        [(h.host, ", ".join(h.roles), ", ".join(h.cells), f"{ends[h.host]:%Y-%m-%d}") for h in hosts],
    )


def _authority(folder: Path) -> Authority:
    from zsight.keys.authority import Authority

    return Authority(folder)
