"""Two poses are told apart by what would look different, and a mesh rests the way the image is for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core import find as finder
from zsight_core.files.mesh_file import read
from zsight_core.model import Box, Mesh, ObjectModel
from zsight_core.render import draw, face_planes, place
from zsight_core.search.contest import NOBODY, TELLING, lead, mark
from zsight_core.simulation.kinect import Kinect
from zsight_core.solid import solid_of
from zsight_core.transform import from_rpy, inverse, transform_xyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.find import Detection

PINHOLE = (400.0, 400.0, 80.0, 60.0)
BAR = solid_of(Box((0.1, 0.05, 0.02)))
MUG, CARTON, BRACKET = (
    ObjectModel(name, read(Path(__file__).parents[2] / f"services/zsight/types/{name}.stl"))
    for name in ("mug", "milk_carton", "l_bracket")
)


def image(T: NDArray[np.float64]) -> NDArray[np.float32]:
    """Depth (120, 160) of the bar before a wall."""
    vertices = place(T, BAR.vertices)
    w, _ = draw(vertices, BAR.faces, face_planes(vertices, BAR.faces), PINHOLE, (0, 0, 160, 120, 1))
    return np.where(w > 0, 1 / np.where(w > 0, w, 1.0), 3.0).astype(np.float32)


def ahead(
    depth: NDArray[np.float32],
    one: NDArray[np.float64],
    other: NDArray[np.float64],
    owners: NDArray[np.int16] | None = None,
) -> float:
    owners = np.full(depth.shape, NOBODY, np.int16) if owners is None else owners
    return lead(depth, PINHOLE, BAR.vertices, BAR.faces, one, other, 1e-3, owners, 0)


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


def test_what_another_solid_explains_tells_nothing() -> None:
    """Two bars along one line: half of each might be of a third one between them, but it is not."""
    true, neighbour, between = (from_rpy((x, 0, 1.0), (0, 0, 0)) for x in (-0.05, 0.05, 0.0))
    depth, owners = np.minimum(image(true), image(neighbour)), np.full((120, 160), NOBODY, np.int16)
    assert abs(ahead(depth, true, between)) < TELLING
    mark(depth, PINHOLE, BAR.vertices, BAR.faces, neighbour, 1e-3, 1, owners)
    assert ahead(depth, true, between, owners) > 10 * TELLING
    mark(depth, PINHOLE, BAR.vertices, BAR.faces, true, 1e-3, 0, owners)
    assert ahead(depth, true, between, owners) > 10 * TELLING  # one's own pixels go on to tell


def test_only_what_shows_the_surface_is_marked_and_what_several_show_is_nobodys() -> None:
    there, aside = from_rpy((0, 0, 1.0), (0, 0, 0)), from_rpy((0.06, 0, 1.0), (0, 0, 0))
    depth, owners = image(there), np.full((120, 160), NOBODY, np.int16)
    depth[:60] = 0.5  # something in front
    mark(depth, PINHOLE, BAR.vertices, BAR.faces, there, 1e-3, 3, owners)
    assert set(np.unique(owners)) == {NOBODY, 3}
    assert ((owners == 3) <= (image(there) < 2) & (depth > 0.6)).all()
    assert (owners == 3).sum() > 300
    before = owners.copy()
    mark(depth, PINHOLE, BAR.vertices, BAR.faces, aside, 1e-3, 4, owners)
    both = (before == 3) & (owners != 3)
    assert both.any()
    assert not np.isin(owners[both], (NOBODY, 3, 4)).any()
    mark(depth, PINHOLE, BAR.vertices, BAR.faces, from_rpy((0, 0, -1.0), (0, 0, 0)), 1e-3, 5, owners)
    assert 5 not in owners


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
    assert off(found, inverse(book.T_WORLD_CAMERA), MUG.shape, T) < 0.02


def off(found: Detection, T_camera_world: NDArray[np.float64], shape: Mesh, T: NDArray[np.float64]) -> float:
    """Metres that the farthest vertex of the nearest of the found poses is off."""
    true = transform_xyz(T_camera_world @ T, shape.vertices)
    poses = (found.T_camera_model, *found.equivalents)
    return min(float(np.linalg.norm(transform_xyz(pose, shape.vertices) - true, axis=1).max()) for pose in poses)


MUG_OVERTURNED = MUG, from_rpy((0.469, -0.1137, 0.8222), (np.pi, 0, -0.4228))
CARTON_THAT_TOUCHES = CARTON, book.at(0.5118, -0.1908, 0.8887, -2.977)
BRACKET_ON_ITS_SIDE = BRACKET, from_rpy((0.6349, -0.0268, 0.7947), (-np.pi / 2, 0, 0.0531))
BLOCK_THAT_TOUCHES = book.TOY_BLOCK, book.at(0.607, 0.0426, 0.7922, -0.7283)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("thing", "neighbour", "pitch"),
    [(MUG_OVERTURNED, CARTON_THAT_TOUCHES, 0.927), (BRACKET_ON_ITS_SIDE, BLOCK_THAT_TOUCHES, 0.9)],
    ids=["a handle behind the mug", "a leg seen from above"],
)
def test_no_part_is_thought_where_a_neighbour_is_seen(
    thing: tuple[ObjectModel, NDArray[np.float64]],
    neighbour: tuple[ObjectModel, NDArray[np.float64]],
    pitch: float,
    seed: int,
) -> None:
    """The handle, or the other leg, would be in another pose where a thing that touches shows its surface."""
    (model, T), (other, _) = thing, neighbour
    assert isinstance(model.shape, Mesh)
    camera = from_rpy((0.027, 0, 1.625), (0, pitch, 0)) @ book.T_OPTICAL
    points = book.cloud(thing, neighbour, noise=Kinect(), seed=seed, T_world_camera=camera)
    answer = finder.find(points, [model, other], T_world_camera=camera)
    (found,) = (found for found in answer.detections if found.type == model.name)
    assert off(found, inverse(camera), model.shape, T) < 0.02
