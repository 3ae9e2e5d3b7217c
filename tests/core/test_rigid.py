from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.core.clouds import LAYOUTS, coordinates, finite, in_layout, random_cloud

from zsight_core.errors import GeometryError, PointsError
from zsight_core.rigid import transform_points
from zsight_core.transform import from_rpy, inverse, transform_xyz

T = from_rpy([0.5, -1.0, 2.0], [0.3, -0.8, 2.5])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_equals_the_reference(layout: str) -> None:
    cloud = random_cloud()
    points = in_layout(cloud, layout)
    moved = transform_points(points, T)
    assert moved.dtype == points.dtype
    assert moved.shape == points.shape
    assert_allclose(finite(moved), transform_xyz(T, finite(cloud).astype(np.float64)), atol=1e-6)
    assert_array_equal(np.isfinite(coordinates(moved)).all(axis=1), np.isfinite(coordinates(cloud)).all(axis=1))
    name = "rgba" if layout == "rgba" else "rgb"
    assert moved[name].tobytes() == points[name].tobytes()


def test_alpha_that_makes_a_nan_of_the_colour_is_carried_over() -> None:
    cloud = random_cloud()
    bits = cloud["rgb"].view(np.uint32)
    bits[...] |= np.uint32(0xFF800000)
    assert_array_equal(transform_points(cloud, T)["rgb"].view(np.uint32), bits)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_there_and_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = from_rpy(rng.normal(size=3), rng.uniform(-3, 3, 3))
    cloud = random_cloud(seed, 5, 40)
    back = transform_points(transform_points(cloud, motion), inverse(motion))
    assert_allclose(finite(back), finite(cloud), atol=1e-5)


def test_normals_are_turned_and_not_shifted() -> None:
    dtype = np.dtype([(name, "<f4") for name in ("x", "y", "z", "normal_x", "normal_y", "normal_z", "curvature")])
    cloud = np.zeros((1, 2), dtype)
    cloud["normal_z"], cloud["curvature"] = 1.0, 0.5
    moved = transform_points(cloud, T)
    assert_allclose(
        [moved["normal_x"], moved["normal_y"], moved["normal_z"]], np.outer(T[:3, 2], [1, 1])[:, None], atol=1e-6
    )
    assert_allclose(moved["x"], 0.5)
    assert_allclose(moved["curvature"], 0.5)


def test_writes_into_the_room_that_is_given() -> None:
    cloud = random_cloud()
    room = np.empty_like(cloud)
    assert transform_points(cloud, T, room) is room
    assert room.tobytes() == transform_points(cloud, T).tobytes()
    with pytest.raises(PointsError, match="output"):
        transform_points(cloud, T, room[1:])
    transform_points(room, inverse(T), room)  # in place
    assert_allclose(finite(room), finite(cloud), atol=1e-5)


def test_only_rigid_motions() -> None:
    for wrong in (np.eye(3), 2 * np.eye(4), np.diag([1.0, 1, -1, 1]), np.full((4, 4), np.nan)):
        with pytest.raises(GeometryError, match="not rigid"):
            transform_points(random_cloud(), wrong)
