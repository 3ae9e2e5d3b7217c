"""Shape, size and place of a thing on a table are measured from one view."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core.errors import GeometryError
from zsight_core.model import Box, Cylinder, ObjectModel, Shape, Sphere, size_of
from zsight_core.scene import understand
from zsight_core.shape_measurement import SHAPES, Measurement, measure_shape
from zsight_core.simulation.kinect import Kinect
from zsight_core.transform import from_rpy

if TYPE_CHECKING:
    from zsight_core.simulation.camera import Noise

Z = book.TABLE_HEIGHT
CAN = Cylinder(0.066, 0.122)


def measured(shape: Shape, T: np.ndarray, noise: Noise | None, only: str = "") -> Measurement:
    points = book.cloud((ObjectModel("thing", shape), T), noise=noise)
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA)
    (segment,) = (segment for segment in scene.segments if segment.support == 0)
    return measure_shape(scene, segment, only)


@pytest.mark.parametrize("noise", [None, Kinect()], ids=["ideal", "kinect"])
@pytest.mark.parametrize(
    ("shape", "T"),
    [
        (Box((0.035, 0.2, 0.035)), book.T_WORLD_BLOCK),
        (Box((0.05, 0.05, 0.05)), from_rpy((0.6, -0.2, Z + 0.025), (0, 0, 0.3))),
        (CAN, from_rpy((0.6, -0.2, Z + 0.061), (0, 0, 0))),
        (Cylinder(0.053, 0.134), from_rpy((0.6, -0.3, Z + 0.0265), (0, np.pi / 2, 0.5))),
        (Sphere(0.067), from_rpy((0.55, -0.3, Z + 0.0335), (0, 0, 0))),
    ],
    ids=["block", "cube", "can", "lying can", "ball"],
)
def test_a_thing_is_measured(shape: Shape, T: np.ndarray, noise: Noise | None) -> None:
    found = measured(shape, T, noise)
    within = 0.0003 if noise is None else 0.002
    assert type(found.shape) is type(shape)
    if isinstance(found.shape, Cylinder):
        assert size_of(found.shape) == pytest.approx(size_of(shape), abs=within)
    assert sorted(size_of(found.shape)) == pytest.approx(sorted(size_of(shape)), abs=within)
    assert (book.T_WORLD_CAMERA @ found.T_camera_model)[:3, 3] == pytest.approx(T[:3, 3], abs=within)
    assert found.explained > 0.9
    assert found.explained == max(found.explained_by.values())
    assert sorted(found.explained_by) == sorted(SHAPES)


def test_a_shape_that_is_known_is_taken() -> None:
    found = measured(CAN, from_rpy((0.6, -0.2, Z + 0.061), (0, 0, 0)), None, only="box")
    assert isinstance(found.shape, Box)
    assert found.explained < 0.8


def test_what_stands_on_something_else_is_refused() -> None:
    crate, cup = ObjectModel("crate", Box((0.2, 0.14, 0.05))), ObjectModel("cup", CAN)
    points = book.cloud((crate, book.at(0.6, -0.3, Z + 0.025)), (cup, book.at(0.6, -0.3, Z + 0.111)))
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA)
    high = max(scene.segments, key=lambda segment: segment.low)
    with pytest.raises(GeometryError, match="expected to see its foot"):
        measure_shape(scene, high)


def test_the_same_cloud_gives_the_same_measures_bit_for_bit() -> None:
    T = from_rpy((0.6, -0.2, Z + 0.061), (0, 0, 0))
    one, other = (measured(CAN, T, Kinect()) for _ in range(2))
    assert one.shape == other.shape
    np.testing.assert_array_equal(one.T_camera_model, other.T_camera_model)
