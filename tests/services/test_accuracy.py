"""How well the book's block is found through a Kinect's noise, and that none is found where there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from zsight import scene_file
from zsight.catalogue import type_files
from zsight.finding import answering
from zsight_core.scene import go_on, understand
from zsight_core.simulation.camera import expose
from zsight_core.simulation.kinect import Kinect
from zsight_core.simulation.raycast import render
from zsight_core.transform import angle_between, from_rpy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight.catalogue.type_files import Catalogue
    from zsight_core.find import Answer

pytestmark = pytest.mark.usefixtures("warm_kernels")

SEEDS = range(20)


def answers(file: scene_file.SceneFile, catalogue: Catalogue) -> list[Answer]:
    """What the finder says of the file's scene through the noise of every seed, all other types being its rivals."""
    scene = scene_file.build(file, catalogue)
    view, T = render(scene.world, scene.camera), scene.camera.T_world_camera
    found = []
    for seed in SEEDS:
        points = expose(view, scene.camera.pinhole, Kinect(), seed)
        understood = understand(points, T_world_camera=T)
        found.append(
            answering.find(
                points, catalogue, "toy_block", scene=understood, T_frame_camera=T, maximum=0, checkpoint=go_on
            )
        )
    return found


def errors(T_world_found: NDArray[np.float64], T_world_true: NDArray[np.float64]) -> tuple[float, float]:
    """Millimetres and degrees, the block's symmetries not counted."""
    turns = [from_rpy((0, 0, 0), (0, b, a)) for a in (0, np.pi) for b in np.arange(4) * np.pi / 2]
    angle = min(angle_between(T_world_found, T_world_true @ turn) for turn in turns)
    return 1e3 * float(np.linalg.norm(T_world_found[:3, 3] - T_world_true[:3, 3])), float(np.degrees(angle))


@pytest.fixture(scope="module")
def catalogue() -> Catalogue:
    return type_files.load(type_files.shipped_folder())


def test_through_kinect_noise_the_block_is_found_to_a_millimetre(catalogue: Catalogue) -> None:
    file = scene_file.read(scene_file.find_scene("book"))
    (truth,) = [entry.T_world_model for entry in file.objects if entry.type == "toy_block"]
    off = []
    for answer in answers(file, catalogue):
        assert answer.status == "found"
        (block,) = answer.detections
        assert block.T_world_model is not None
        off.append(errors(block.T_world_model, truth))
    millimetres, degrees = np.median(off, axis=0)
    assert millimetres <= 1.5
    assert degrees <= 1.0


def test_without_the_block_it_is_not_found_every_time(catalogue: Catalogue) -> None:
    file = scene_file.read(scene_file.find_scene("book"))
    empty = file.model_copy(update={"objects": tuple(entry for entry in file.objects if entry.type is None)})
    assert len(empty.objects) == len(file.objects) - 1
    assert [(answer.status, answer.detections) for answer in answers(empty, catalogue)] == [("not_found", ())] * len(
        SEEDS
    )
