"""Options that several commands share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from zsight.errors import UsageError
from zsight.network import Network, endpoints_given

__all__ = [
    "CameraPose",
    "Connect",
    "Force",
    "Intrinsics",
    "Json",
    "Namespace",
    "Open",
    "Out",
    "Picture",
    "network_of",
    "refuse_options",
]

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Connect = Annotated[
    str | None, typer.Option("--connect", metavar="ENDPOINT", help="The router, such as tcp/192.0.2.7:7447.")
]
Namespace = Annotated[str | None, typer.Option("--namespace", help="The cell, where several share a network.")]
Open = Annotated[bool, typer.Option("--open", help="Let a router be reached from other hosts without asking for keys.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite the output file.")]
Out = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the cloud here (.pcd or .ply).")
]
Intrinsics = Annotated[
    Path | None, typer.Option("--intrinsics", metavar="FILE", help="Camera of an image pair: .toml or .json.")
]
CameraPose = Annotated[
    str,
    typer.Option(
        "--camera-pose",
        metavar='"X Y Z QX QY QZ QW"',
        help="The camera in the world, where it is known; the word viewpoint takes the one that the file has.",
    ),
]


def _require_png(path: Path | None) -> Path | None:
    if path is not None and path.suffix.lower() != ".png":
        raise UsageError(f"the picture is to be {path}; expected a name that ends in .png")
    return path


Picture = Annotated[
    Path | None,
    typer.Option("--picture", metavar="FILE", callback=_require_png, help="Draw the result into a PNG file."),
]


def network_of(connect: str | None, namespace: str | None = None) -> Network:
    """The network from the options, else from the environment."""
    network = Network.from_environment()
    if connect is not None:
        network = replace(network, connect=endpoints_given(connect, "--connect"))
    return network if namespace is None else replace(network, namespace=namespace)


def refuse_options(context: typer.Context, names: tuple[str, ...], why: str) -> None:
    """That none of these options is given, which would be passed over.

    Raises:
        UsageError: one is.
    """
    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise UsageError(f"--{name.replace('_', '-')} {why}")
