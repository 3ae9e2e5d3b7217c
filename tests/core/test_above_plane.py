from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import ConvexHull

from zsight_core.above_plane import _outline, _within, above_mask, points_above
from zsight_core.errors import GeometryError
from zsight_core.plane import plane_through
from zsight_core.points import from_xyz
from zsight_core.transform import from_rpy, transform_xyz

T_CAMERA_TABLE = from_rpy([0.1, 0.0, 1.0], [np.pi - 0.7, 0.2, 0.3])
PLANE = plane_through(T_CAMERA_TABLE[:3, 2], T_CAMERA_TABLE[:3, 3])


def test_heights_are_counted_towards_the_camera() -> None:
    flat = np.array([[0, 0, 0.05], [0.1, 0, 0.01], [0, 0.2, -0.05], [0, 0, 0.5], [np.nan, 0, 0]])
    cloud = from_xyz(transform_xyz(T_CAMERA_TABLE, flat))
    assert_array_equal(above_mask(cloud, PLANE, 0.02, 0.4), [[True, False, False, False, False]])
    assert points_above(cloud, PLANE, 0.0, 1.0).size == 3
    with pytest.raises(GeometryError, match="lower one first"):
        points_above(cloud, PLANE, 0.4, 0.02)


def test_only_what_stands_over_the_surface() -> None:
    rng = np.random.default_rng(0)
    surface = np.column_stack([rng.uniform(-0.3, 0.3, (400, 2)), np.zeros(400)])
    over = np.column_stack([rng.uniform(-0.2, 0.2, (50, 2)), rng.uniform(0.02, 0.1, 50)])
    beside = over + np.array([0.9, 0, 0])
    cloud = from_xyz(transform_xyz(T_CAMERA_TABLE, np.concatenate([surface, over, beside])))
    mask = np.arange(500).reshape(1, -1) < 400
    assert points_above(cloud, PLANE, 0.01, 0.2).size == 100
    kept = points_above(cloud, PLANE, 0.01, 0.2, mask)
    assert_array_equal(kept, cloud[:, 400:450])
    with pytest.raises(GeometryError, match="at least 3"):
        points_above(cloud, PLANE, 0.01, 0.2, np.zeros((1, 500), np.bool_))


@pytest.mark.parametrize("count", [3, 10, 1000, 20000])
def test_outline_is_the_convex_hull(count: int) -> None:
    flat = np.random.default_rng(count).normal(size=(count, 2)).astype(np.float32)
    outline = _outline(flat)
    expected = flat[ConvexHull(flat).vertices]
    assert_allclose(outline[np.lexsort(outline.T)], expected[np.lexsort(expected.T)])
    assert _within(flat, outline).all()
    assert not _within(flat + np.float32(20), outline).any()
