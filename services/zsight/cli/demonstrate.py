"""``zsight demo``: the main job on one machine."""

from __future__ import annotations

from typing import Annotated

import typer

from zsight.cli.options import Json, Picture
from zsight.cli.output import print_json, say
from zsight.cli.running import require_warm

__all__ = ["demo"]


def demo(
    json: Json = False,
    picture: Picture = None,
    scene: Annotated[str, typer.Option("--scene", help="Simulated scene: a name or a .yaml file.")] = "book",
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Seed of the scene's noise.")] = None,
) -> None:
    """Find the toy block in a simulated scene: router, camera, voxel, planes and finder as processes, then all stopped."""
    from zsight.demonstration import demonstrate
    from zsight.scene_file import find_scene, read

    read(find_scene(scene))  # a mistake is said before kernels are compiled
    require_warm()
    result = demonstrate(scene=scene, seed=seed, picture=picture, say=say)
    if json:
        print_json(result.report)
    raise typer.Exit(0 if result.found else 1)
