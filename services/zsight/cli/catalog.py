"""``zsight catalog``: the object types that the finders know."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, print_table, say

if TYPE_CHECKING:
    from zsight.client import CellClient
    from zsight_protocol.object_type import ObjectType

__all__ = ["app"]

app = typer.Typer(help="The object types that the finders know.", no_args_is_help=True, rich_markup_mode=None)

Name = Annotated[str, typer.Argument(metavar="TYPE", help="Name of a type, or its number.")]


@app.command(name="list")
def list_types(json: Json = False, connect: Connect = None, namespace: Namespace = None) -> None:
    """All types."""
    with _cell(connect, namespace) as cell:
        types = cell.catalog.list()
    if json:
        print_json({"types": [_type_json(kind) for kind in types]})
        return
    print_table(
        ["type", "code", "shape", ""],
        [(t.name, t.code if t.code is not None else "-", _shape(t), t.notes) for t in types],
    )


@app.command()
def show(name: Name, json: Json = False, connect: Connect = None, namespace: Namespace = None) -> None:
    """One type, as its file has it."""
    import yaml

    with _cell(connect, namespace) as cell:
        kind = cell.catalog.get(name)
    if json:
        print_json(_type_json(kind))
    else:
        values = {name: value for name, value in _type_json(kind).items() if value not in ("", [], {})}
        text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
        typer.echo(text, nl=False)


@app.command()
def add(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="YAML file of the type.")],
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Add a type, or change the one of its name."""
    from zsight.object_catalogue import read_type

    kind = read_type(file)
    with _cell(connect, namespace) as cell:
        say(cell.catalog.add(kind))


@app.command()
def remove(name: Name, connect: Connect = None, namespace: Namespace = None) -> None:
    """Remove a type."""
    with _cell(connect, namespace) as cell:
        say(cell.catalog.remove(name))


def _cell(connect: str | None, namespace: str | None) -> CellClient:
    from zsight.client import CellClient
    from zsight.runtime import join

    return CellClient(join(network_of(connect, namespace)))


def _type_json(kind: ObjectType) -> dict[str, Any]:
    values: dict[str, Any] = kind.model_dump(mode="json", exclude_none=True)
    return values


def _shape(kind: ObjectType) -> str:
    shape: dict[str, Any] = kind.shape.model_dump(mode="json", exclude_none=True)
    ((name, values),) = shape.items()
    return f"{name} " + ", ".join(f"{key} {value}" for key, value in values.items())
