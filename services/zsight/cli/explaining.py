"""``zsight why`` and ``zsight calibrate``: what went wrong, and where the camera really is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, say
from zsight.errors import DeadlinePassed, UsageError, ZsightError

if TYPE_CHECKING:
    from zsight_core.points import Points

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
        say("no goal of that id is remembered" if goal else "nothing was missed in the last minute")
    for update in [] if json else updates:
        say(explain(update))
    raise typer.Exit(0 if updates else 1)


@calibrate.command()
def level(
    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE]", help="A cloud from a file; else one off the wire.")
    ] = None,
    camera: Annotated[str, typer.Option("--camera", help="Whose cloud is taken off the wire.")] = "kinect",
    height: Annotated[float, typer.Option("--height", help="Height of the surface in the world, metres.")] = 0.0,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the pose as a setting (TOML).")
    ] = None,
    timeout: Annotated[float, typer.Option("--timeout", help="Seconds to wait for a cloud.")] = 5.0,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """A camera's roll, pitch and height from the table or floor it sees; its place and yaw are left at zero."""
    import numpy as np

    from zsight_core.level import level_camera
    from zsight_core.scene import understand
    from zsight_core.transform import quaternion

    scene = understand(_points(file, camera, timeout, connect, namespace))
    if not scene.supports:
        raise ZsightError("no level surface is in view: point the camera at a table or the floor")
    surface = scene.supports[0]
    T_world_camera = level_camera(surface.normal, surface.distance, height)
    pose = [*T_world_camera[:3, 3], *quaternion(T_world_camera)]
    x_forward = T_world_camera[:3, 2]
    roll = float(np.arctan2(-T_world_camera[2, 0], -T_world_camera[2, 1]))
    pitch = float(np.arcsin(np.clip(-x_forward[2], -1, 1)))
    text = " ".join(f"{value:.6f}" for value in pose)
    if output is not None:
        if output.exists():
            raise UsageError(f"{output} exists already; choose another name")
        output.write_text(f'[process.camera]\npose = "{text}"\n', encoding="utf-8")
    if json:
        print_json(
            {"pose": pose, "roll": roll, "pitch": pitch, "height": float(T_world_camera[2, 3]), "rms": surface.rms}
        )
        return
    say(f"roll {np.degrees(roll):.2f}, pitch {np.degrees(pitch):.2f} degrees down, {T_world_camera[2, 3]:.4f} m high")
    say(f'pose "{text}"')


def _points(file: Path | None, camera: str, timeout: float, connect: str | None, namespace: str | None) -> Points:
    from zsight import cloud_input
    from zsight.runtime import join
    from zsight.snapshots import take_snapshot

    if file is not None:
        return cloud_input.read(file).points
    with join(network_of(connect, namespace)) as bus:
        key = bus.cell.points(camera)
        taken = take_snapshot(bus, key, timeout)
    if taken is None:
        raise DeadlinePassed(f"no cloud on {key} within {timeout:g} s: is the camera running? See: zsight topic list")
    return taken.points
