from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import cKDTree
from tests.core.clouds import LAYOUTS, in_layout, random_cloud

from zsight_core.errors import GeometryError, PointsError
from zsight_core.normals import normals
from zsight_core.points import from_xyz
from zsight_core.transform import from_rpy, transform_xyz

Rows = np.ndarray[Any, np.dtype[Any]]


def reference(xyz: Rows, radius: float) -> Rows:
    """By the eigenvectors of the covariances, one point after the other."""
    found = np.full((len(xyz), 3), np.nan)
    index = np.flatnonzero(np.isfinite(xyz).all(axis=1))
    dense = xyz[index].astype(np.float64)
    tree = cKDTree(dense)
    for i, point in zip(index, dense, strict=True):
        near = dense[tree.query_ball_point(point, radius)]
        if len(near) >= 3:
            normal = np.linalg.eigh(np.cov(near.T, bias=True))[1][:, 0]
            found[i] = -normal if normal @ point > 0 else normal
    return found


def agree(found: Rows, expected: Rows) -> None:
    """The same points have one, and they point the same way (either way where they lie across the line of sight)."""
    found, expected = found.reshape(-1, 3), expected.reshape(-1, 3)
    assert_array_equal(np.isfinite(found[:, 0]), np.isfinite(expected[:, 0]))
    known = np.isfinite(found[:, 0])
    assert_allclose(np.abs((found[known] * expected[known]).sum(axis=1)), 1, atol=1e-4)


def wavy(seed: int = 0, count: int = 700) -> Rows:
    """A curved sheet seen from above."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.5, 0.5, (2, count))
    return np.column_stack([x, y, 1 + 0.1 * np.sin(5 * x) * np.cos(4 * y)]).astype(np.float32)


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.sampled_from([0.08, 0.15, 0.4]))
def test_equals_the_reference(seed: int, radius: float) -> None:
    xyz = wavy(seed)
    xyz[::9] = np.nan
    xyz[3] = np.inf
    agree(normals(xyz, radius), reference(xyz, radius))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_layout(layout: str) -> None:
    cloud = random_cloud(1, 10, 60)
    assert normals(in_layout(cloud, layout), 0.5).tobytes() == normals(cloud, 0.5).tobytes()


def test_they_are_unit_vectors_towards_the_origin() -> None:
    xyz = wavy()
    found = normals(xyz, 0.2)[0]
    assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-5)
    assert ((found * xyz).sum(axis=1) < 0).all()


def test_they_turn_with_the_cloud_and_keep_its_order() -> None:
    xyz, T = wavy(2), from_rpy([0, 0, 0], [0.3, -0.8, 2.0])
    order = np.random.default_rng(0).permutation(len(xyz))
    turned = normals(transform_xyz(T, xyz.astype(np.float64))[order], 0.3)[0]
    assert_allclose(turned, (normals(xyz, 0.3)[0] @ T[:3, :3].T)[order], atol=1e-3)


def test_none_where_points_do_not_tell() -> None:
    line = np.linspace([0, 0, 1], [1, 0, 1], 50)
    assert np.isnan(normals(line, 0.1)).all()
    assert np.isnan(normals(np.array([[0, 0, 1], [0.01, 0, 1], [5, 5, 5]]), 0.1)).all()
    assert np.isnan(normals(np.tile([[0.3, 0.2, 1.0]], (20, 1)), 0.1)).all()
    assert np.isnan(normals(np.full((4, 3), np.nan), 0.1)).all()
    assert normals(np.empty((0, 3)), 0.1).shape == (1, 0, 3)


def test_room_that_is_given_is_used() -> None:
    cloud = random_cloud()
    room = np.empty((*cloud.shape, 3), np.float32)
    assert normals(cloud, 0.3, room) is room
    assert room.tobytes() == normals(cloud, 0.3).tobytes()
    with pytest.raises(PointsError, match="output"):
        normals(cloud, 0.3, room[:-1])


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_a_radius_is_a_length(radius: float) -> None:
    with pytest.raises(GeometryError, match="above zero"):
        normals(random_cloud(), radius)


def test_a_grid_that_would_overflow_is_refused() -> None:
    with pytest.raises(GeometryError, match="too small"):
        normals(from_xyz([[1e7, 0, 0]]), 0.01)
