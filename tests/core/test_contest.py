"""Two poses are told apart by what would look different, and a mesh rests the way the image is for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core import find as finder
from zsight_core.contest import TELLING, lead
from zsight_core.mesh_file import read
from zsight_core.model import Box, Mesh, ObjectModel
from zsight_core.render import draw, face_planes, place
from zsight_core.simulation.kinect import Kinect
from zsight_core.solid import solid_of
from zsight_core.transform import from_rpy, transform_xyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

PINHOLE = (400.0, 400.0, 80.0, 60.0)
BAR = solid_of(Box((0.1, 0.05, 0.02)))
MUG = ObjectModel("mug", read(Path(__file__).parents[2] / "services/zsight/types/mug.stl"))


def image(T: NDArray[np.float64]) -> NDArray[np.float32]:
    """Depth (120, 160) of the bar before a wall."""
    vertices = place(T, BAR.vertices)
    w, _ = draw(vertices, BAR.faces, face_planes(vertices, BAR.faces), PINHOLE, (0, 0, 160, 120, 1))
    return np.where(w > 0, 1 / np.where(w > 0, w, 1.0), 3.0).astype(np.float32)


def ahead(depth: NDArray[np.float32], one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return lead(depth, PINHOLE, BAR.vertices, BAR.faces, one, other, 1e-3)


def test_the_true_pose_leads_and_the_other_is_as_far_behind() -> None:
    true, wrong = from_rpy((0, 0, 1.0), (0, 0, 0)), from_rpy((0, 0, 1.0), (0, 0, 0.6))
    assert ahead(image(true), true, wrong) > TELLING
    assert ahead(image(true), wrong, true) == -ahead(image(true), true, wrong)


def test_poses_that_look_the_same_are_level() -> None:
    true = from_rpy((0, 0, 1.0), (0, 0, 0.3))
    assert ahead(image(true), true, from_rpy((0, 0, 1.0), (0, 0, 0.3 + np.pi))) == 0


def test_what_is_hidden_tells_nothing() -> None:
    true, wrong = from_rpy((0, 0, 1.0), (0, 0, 0)), from_rpy((0, 0, 1.0), (0, 0, np.pi / 2))
    depth = image(true)
    depth[:] = 0.4
    assert ahead(depth, true, wrong) == 0
    depth[:] = 0  # not measured
    assert ahead(depth, true, wrong) == 0


def test_behind_the_camera_or_beyond_the_image_tells_nothing() -> None:
    true = from_rpy((0, 0, 1.0), (0, 0, 0))
    assert ahead(image(true), true, from_rpy((0, 0, -1.0), (0, 0, 0))) == 0
    assert ahead(image(true), from_rpy((3, 0, 1.0), (0, 0, 0)), from_rpy((3, 0, 1.0), (0, 0, 1.0))) == 0


@pytest.mark.parametrize("yaw", [0.3, 1.9, 3.4, 5.0])
def test_a_mug_is_found_the_way_round_it_stands(yaw: float) -> None:
    """Or one of the poses that the view does not tell from the answer is."""
    assert isinstance(MUG.shape, Mesh)
    T = book.at(0.6, -0.3, book.TABLE_HEIGHT + 0.0475, yaw)
    points = book.cloud((MUG, T), noise=Kinect(), seed=7)
    (found,) = finder.find(points, [MUG], T_world_camera=book.T_WORLD_CAMERA).detections
    true = transform_xyz(np.linalg.inv(book.T_WORLD_CAMERA) @ T, MUG.shape.vertices)
    poses = [found.T_camera_model, *found.equivalents]
    off = [float(np.linalg.norm(transform_xyz(pose, MUG.shape.vertices) - true, axis=1).max()) for pose in poses]
    assert min(off) < 0.02
