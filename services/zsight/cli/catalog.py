"""``zsight catalog``: the object types that the finders know."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import (
    CameraPose,
    Connect,
    Force,
    Intrinsics,
    Json,
    Namespace,
    Picture,
    network_of,
    refuse_options,
)
from zsight.cli.output import print_json, print_table, say
from zsight.words import numbers

if TYPE_CHECKING:
    from zsight.client import CellClient
    from zsight_protocol.object_type import Derived, ObjectType, Taught

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
def show(
    name: Name,
    version: Annotated[int | None, typer.Option("--version", min=1, help="As it was in this version.")] = None,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """One type, as its file has it, and what follows from its shape: size, symmetries, stable poses."""
    with _cell(connect, namespace) as cell:
        kind = cell.catalog.get(name, version)
        derived = cell.catalog.derived(name) if version is None else None
    if json:
        print_json(_type_json(kind) | ({"derived": derived.model_dump(mode="json")} if derived is not None else {}))
        return
    typer.echo(_as_yaml(kind), nl=False)
    if derived is not None:
        say(_derived(derived))


@app.command()
def add(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="YAML file of the type.")],
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Add a type, or change the one of its name; a mesh that lies beside the file goes along."""
    from zsight.catalogue.type_files import mesh_beside, read_type

    kind = read_type(file)
    mesh = mesh_beside(kind, file)
    with _cell(connect, namespace) as cell:
        say(cell.catalog.add(kind, mesh))


@app.command()
def remove(name: Name, connect: Connect = None, namespace: Namespace = None) -> None:
    """Remove a type."""
    with _cell(connect, namespace) as cell:
        say(cell.catalog.remove(name))


@app.command()
def teach(
    context: typer.Context,
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name of the type; one that is there becomes its next version.")
    ],
    at: Annotated[
        str | None,
        typer.Option("--at", metavar='"X Y Z"', help="Any place in the thing, metres; not needed where it is alone."),
    ] = None,
    frame: Annotated[str, typer.Option("--frame", help="Frame of the place; the world's if not given.")] = "",
    camera: Annotated[str, typer.Option("--camera", help="Whose clouds are looked at; any if not given.")] = "",
    shape: Annotated[
        str, typer.Option("--shape", help="box, cylinder, 'lying cylinder' or sphere; the best if not given.")
    ] = "",
    code: Annotated[int | None, typer.Option("--code", min=0, help="Number of the type.")] = None,
    notes: Annotated[str, typer.Option("--notes", help="For people.")] = "",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Measure and show; add nothing.")] = False,
    cloud: Annotated[
        Path | None, typer.Option("--cloud", metavar="FILE", help="Look into this file instead; no network.")
    ] = None,
    camera_pose: CameraPose = "",
    intrinsics: Intrinsics = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the type here (.yaml).")
    ] = None,
    picture: Picture = None,
    json: Json = False,
    force: Force = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Make a type of a thing that stands before a camera: measure it, choose its shape, add it to all finders.

    With --cloud it is measured in a file, and only written (--output) or printed.
    """
    from zsight.catalogue.type_files import write_type

    place = None if at is None else _place(at)
    if cloud is not None:
        refuse_options(context, ("frame", "camera", "dry_run", "connect", "namespace"), "means nothing with --cloud")
        from zsight.offline import teach_from_file
        from zsight_protocol.object_type import Teaching

        asked = Teaching(place=place, shape=_shape_name(shape), code=code, notes=notes)
        kind, taught = teach_from_file(cloud, name, asked, intrinsics=intrinsics, pose=camera_pose)
    else:
        refuse_options(context, ("camera_pose", "intrinsics"), "needs --cloud FILE")
        with _cell(connect, namespace) as cell:
            kind, taught = cell.catalog.teach(
                name, place=place, frame=frame, camera=camera, shape=_shape_name(shape), code=code, notes=notes,
                keep=not dry_run,
            )  # fmt: skip
    if output is not None:
        write_type(kind, output, overwrite=force)
    if picture is not None:
        picture.write_bytes(taught.picture)
    if json:
        print_json({"type": _type_json(kind), **_taught_json(taught)})
        return
    position = numbers([taught.pose.position.x, taught.pose.position.y, taught.pose.position.z], 3)
    told = ", ".join(f"{shape} {share:.0%}" for shape, share in taught.explained_by.items())
    say(f"{kind.name}: {_shape(kind)}, at {position} m in {taught.header.frame_id}; explained: {told}")
    if cloud is None and not dry_run:
        say(f"{'changed' if kind.version > 1 else 'added'} {kind.name}, version {kind.version}")
    elif output is None:
        typer.echo(_as_yaml(kind), nl=False)


def _place(text: str) -> tuple[float, float, float]:
    from zsight.errors import UsageError

    try:
        x, y, z = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        raise UsageError(f"--at is {text!r}; expected three numbers: x y z") from None
    return x, y, z


def _shape_name(text: str) -> str:
    from zsight.errors import UsageError

    known = ("", "box", "cylinder", "lying cylinder", "sphere")
    if text not in known:
        raise UsageError(f"--shape is {text!r}; expected one of {', '.join(known[1:])}")
    return text


def _taught_json(taught: Taught) -> dict[str, Any]:
    place, turn = taught.pose.position, taught.pose.orientation
    return {
        "stamp_ns": taught.header.stamp.ns,
        "frame_id": taught.header.frame_id,
        "position": [place.x, place.y, place.z],
        "orientation": [turn.x, turn.y, turn.z, turn.w],
        "explained": taught.explained,
        "misfit": taught.misfit,
        "explained_by": taught.explained_by,
    }


def _as_yaml(kind: ObjectType) -> str:
    import yaml

    values = {name: value for name, value in _type_json(kind).items() if value not in ("", [], {})}
    text: str = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    return text


def _cell(connect: str | None, namespace: str | None) -> CellClient:
    from zsight.client import CellClient
    from zsight.runtime import join

    return CellClient(join(network_of(connect, namespace)))


def _type_json(kind: ObjectType) -> dict[str, Any]:
    values: dict[str, Any] = kind.model_dump(mode="json", exclude_none=True)
    return values


def _derived(derived: Derived) -> str:
    """What follows from a shape, in words."""
    names = {(1.0, 0.0, 0.0): "x", (0.0, 1.0, 0.0): "y", (0.0, 0.0, 1.0): "z"}
    turns = [
        f"{names.get(turn.axis, numbers(turn.axis, 2))} by {f'1/{turn.order} turn' if turn.order else 'any angle'}"
        for turn in derived.symmetries
    ]
    poses = [f"{pose.share:.0%} at {pose.height:.4f} m" for pose in derived.stable_poses]
    return (
        f"size {numbers(derived.size)} m; the same when turned about {', '.join(turns) or 'nothing'};"
        f" stable poses: {len(poses)}" + (f" ({', '.join(poses)})" if poses else "")
    )


def _shape(kind: ObjectType) -> str:
    shape: dict[str, Any] = kind.shape.model_dump(mode="json", exclude_none=True)
    ((name, values),) = shape.items()
    return f"{name} " + ", ".join(f"{key} {value}" for key, value in values.items())
