"""``zsight why`` and ``zsight calibrate``: what went wrong, and where the camera really is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, say
from zsight.errors import UsageError

if TYPE_CHECKING:
    from zsight.levelling import CameraLevel


__all__ = ["calibrate", "why"]

calibrate = typer.Typer(help="Measure where the camera is.", no_args_is_help=True, rich_markup_mode=None)


def why(
    goal: Annotated[
        str | None, typer.Argument(metavar="[GOAL]", help="Id of a goal; the last misses if not given.")
    ] = None,
    last: Annotated[int, typer.Option("--last", min=1, help="How many misses.")] = 3,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Say why objects were not found in the last minute: what was seen, what came nearest, what would help."""
    from zsight.client import CellClient
    from zsight.explaining import explain
    from zsight.runtime import join

    with CellClient(join(network_of(connect, namespace))) as cell:
        updates = cell.results(goal)
    if goal is None:
        updates = [u for u in updates if u.final and u.result is not None and not u.result.objects][-last:]
    if json:
        print_json({"goals": [update.model_dump(mode="json") for update in updates]})
    elif not updates:
        say(f"no goal is called {goal}" if goal else "nothing was missed in the last minute")
    for update in [] if json else updates:
        say(explain(update))
    raise typer.Exit(0 if updates else 1)


@calibrate.command()
def level(
    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE]", help="A cloud from a file; else one off the wire.")
    ] = None,
    camera: Annotated[str, typer.Option("--camera", help="Which running camera.")] = "kinect",
    height: Annotated[float, typer.Option("--height", help="Height of the surface in the world, metres.")] = 0.0,
    apply: Annotated[bool, typer.Option("--set", help="Let the running camera stand there from now on.")] = False,
    save: Annotated[bool, typer.Option("--save", help="The same, and after it was started again too.")] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the pose as a setting (TOML).")
    ] = None,
    timeout: Annotated[float, typer.Option("--timeout", help="Seconds to wait for a cloud.")] = 5.0,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """A camera's roll, pitch and height from the table or floor it sees; its place and yaw stay what they were."""
    if file is not None and (apply or save):
        raise UsageError("--set and --save mean a running camera; leave the file out")
    if output is not None and output.exists():
        raise UsageError(f"{output} exists already; choose another name")
    found = _level(file, camera, height, timeout, connect, namespace, apply=apply or save, save=save)
    if output is not None:
        output.write_text(f'[process.camera]\npose = "{found.setting}"\n', encoding="utf-8")
    if json:
        values = {"roll": found.roll, "pitch": found.pitch, "height": found.height, "rms": found.rms}
        print_json({"pose": found.pose, **values, "area": found.area, "set": apply or save, "saved": save})
        return
    say(
        f"roll {math.degrees(found.roll):.2f}, pitch {math.degrees(found.pitch):.2f} degrees down, {found.height:.4f} m high"
    )
    say(f"by a surface of {found.area:.2f} m2, {found.rms * 1e3:.2f} mm rms about its plane")
    say(f'pose "{found.setting}"')
    say(_what_next(file, camera, apply=apply, save=save))


def _what_next(file: Path | None, camera: str, *, apply: bool, save: bool) -> str:
    if save:
        return f"camera {camera} stands there now, and after it was started again"
    if apply:
        return f"camera {camera} stands there until it is started again; to keep it: --save, or pose in the cell's file"
    return "to use it: pose in the cell's file" + ("" if file is not None else ", or --set for the running camera")


def _level(
    file: Path | None,
    camera: str,
    height: float,
    timeout: float,
    connect: str | None,
    namespace: str | None,
    *,
    apply: bool,
    save: bool,
) -> CameraLevel:
    from zsight import cloud_input
    from zsight.cli.running import require_warm
    from zsight.client import CellClient
    from zsight.levelling import level_of
    from zsight.runtime import join

    require_warm()
    if file is not None:
        return level_of(cloud_input.read(file).points, height)
    with CellClient(join(network_of(connect, namespace))) as cell:
        return cell.level_camera(camera, surface_height=height, timeout=timeout, apply=apply, save=save)
