"""What became of each point, on truth that is known, and how the limits change it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core.model import Box, ObjectModel
from zsight_core.points import from_xyz, xyz
from zsight_core.scene import understand
from zsight_core.scene_limits import SceneLimits
from zsight_core.scene_reasons import Reason, reasons
from zsight_core.transform import transform_xyz

pytestmark = pytest.mark.usefixtures("warm_kernels")

Z = book.TABLE_HEIGHT
CARTON = ObjectModel("carton", Box((0.06, 0.09, 0.2)))
CRUMB = ObjectModel("crumb", Box((0.02, 0.02, 0.02)))
POINTS = book.cloud((CARTON, book.at(0.6, -0.1, Z + 0.1)), (CRUMB, book.at(0.5, -0.45, Z + 0.01)))
WORLD = transform_xyz(book.T_WORLD_CAMERA, xyz(POINTS).astype(np.float64))


def told(limits: SceneLimits) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return reasons(POINTS, understand(POINTS, T_world_camera=book.T_WORLD_CAMERA, limits=limits))


def of(model: ObjectModel, x: float, y: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """The points of a box that stands there, without its rim to the table."""
    assert isinstance(model.shape, Box)
    inside = np.abs(WORLD[..., :2] - (x, y)) <= np.array(model.shape.size[:2]) / 2 + 0.001
    return np.asarray(inside.all(axis=-1) & (WORLD[..., 2] > Z + 0.006))


def test_every_point_has_the_reason_that_the_truth_gives_it() -> None:
    found = told(SceneLimits())
    assert ((found == Reason.NO_DEPTH) == ~np.isfinite(xyz(POINTS)[..., 2])).all()
    for part in (of(CARTON, 0.6, -0.1), of(CRUMB, 0.5, -0.45)):
        assert (found[part] == Reason.THING).mean() > 0.95
    on_table = np.abs(WORLD[..., 2] - Z) < 0.001
    assert (found[on_table] == Reason.SURFACE).mean() > 0.99
    assert (WORLD[found == Reason.BELOW][:, 2] < Z).all()
    assert (WORLD[found == Reason.TOO_HIGH][:, 2] > 0.6).all()  # the rim of the table, over the floor


@pytest.mark.parametrize(
    ("limits", "part", "reason"),
    [
        (SceneLimits(smallest=2000), of(CRUMB, 0.5, -0.45), Reason.TOO_SMALL),
        (SceneLimits(largest=0.1), of(CARTON, 0.6, -0.1), Reason.TOO_LARGE),
        (SceneLimits(highest=0.1), of(CARTON, 0.6, -0.1) & (WORLD[..., 2] > Z + 0.11), Reason.TOO_HIGH),
        (SceneLimits(lowest=0.03), of(CRUMB, 0.5, -0.45), Reason.SURFACE),
    ],
)
def test_a_limit_takes_what_is_beyond_it_and_says_so(
    limits: SceneLimits, part: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], reason: Reason
) -> None:
    assert part.sum() > 100
    assert (told(SceneLimits())[part] == Reason.THING).mean() > 0.95
    assert (told(limits)[part] == reason).mean() > 0.9


def test_what_lies_below_the_only_surface_and_what_has_none_are_told_apart() -> None:
    scene = understand(POINTS, T_world_camera=book.T_WORLD_CAMERA)
    elsewhere = scene.kind != 0
    under = replace(scene, kind=np.where(elsewhere, 1, 0).astype(np.uint8), pixel_labels=0 * scene.pixel_labels)
    raised = replace(under.supports[0], T_camera_support=under.supports[0].T_camera_support @ book.at(0, 0, 0.5))
    found = reasons(POINTS, replace(under, supports=[raised]))
    on_table = (np.abs(WORLD[..., 2] - Z) < 0.001) & (np.abs(WORLD[..., :2] - (0.75, -0.3)) < 0.3).all(axis=-1)
    assert (found[on_table] == Reason.BELOW).all()
    assert set(np.unique(reasons(POINTS, replace(under, supports=[])))) <= {Reason.NO_DEPTH, Reason.BESIDE}


def test_a_cloud_without_rows_is_told_in_its_own_order() -> None:
    finite = np.isfinite(xyz(POINTS)[..., 2])
    flat = from_xyz(xyz(POINTS)[finite])
    found = reasons(flat, understand(flat, T_world_camera=book.T_WORLD_CAMERA))
    assert found.shape == flat.shape
    assert (found.reshape(-1)[of(CARTON, 0.6, -0.1)[finite]] == Reason.THING).mean() > 0.8
