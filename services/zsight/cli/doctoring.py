"""``zsight doctor``: what is wrong, and what to do."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json

if TYPE_CHECKING:
    from zsight.hosts.doctor import Finding

__all__ = ["doctor"]


def doctor(
    process: Annotated[
        str, typer.Option("--process", help="Only whether this process of this host is well: for health checks.")
    ] = "",
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Look at this host and its cell; exit code 1 where something has failed."""
    from zsight.hosts.doctor import FAILED, examine

    findings = []
    for finding in examine(network_of(connect, namespace), process=process):
        findings.append(finding)
        if not json:
            _print(finding)
    failed = [finding.check for finding in findings if finding.status == FAILED]
    if json:
        print_json({"healthy": not failed, "checks": [asdict(finding) for finding in findings]})
    raise typer.Exit(1 if failed else 0)


def _print(finding: Finding) -> None:
    typer.echo(f"{finding.status:8} {finding.check}: {finding.found}")
    if finding.advice:
        typer.echo(f"{'':8}   -> {finding.advice}")
