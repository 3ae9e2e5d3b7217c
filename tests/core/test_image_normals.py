from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.core.clouds import LAYOUTS, in_layout

from zsight_core.errors import GeometryError, PointsError
from zsight_core.image_normals import image_normals
from zsight_core.points import from_xyz, xyz
from zsight_core.rigid import transform_points
from zsight_core.transform import from_rpy

if TYPE_CHECKING:
    from zsight_core.points import Points

Rows = np.ndarray[Any, np.dtype[Any]]
WINDOWS = {10: [3, 4, 5, 7, 10], 5: [3, 4, 5], 3: [3]}


def image(depth: Rows) -> Points:
    """The cloud of a depth image by a pinhole camera of f = 60 pixels."""
    height, width = depth.shape
    v, u = np.mgrid[0:height, 0:width]
    return from_xyz(np.stack([(u - width / 2) / 60 * depth, (v - height / 2) / 60 * depth, depth], axis=-1))


def bumpy(seed: int = 0, height: int = 40, width: int = 52) -> Points:
    """A slanted, curved and noisy surface with a step in depth and holes."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:height, 0:width]
    depth = 1 + 0.004 * u - 0.002 * v + 0.03 * np.sin(u / 7) + rng.normal(0, 2e-4, (height, width))
    depth[:, 35:] += 0.5
    depth[rng.random((height, width)) < 0.003] = np.nan
    depth[3, 4] = np.inf
    return image(depth)


def reference(points: Points, window: int) -> Rows:
    """Pixel by pixel: edges, steps to the nearest one, the window that fits, slopes by least squares."""
    p = xyz(points).astype(np.float64)
    height, width = points.shape
    normals = np.full((height, width, 3), np.nan)
    steps = steps_to_an_edge(p)
    for r in range(height):
        for c in range(width):
            for size in WINDOWS[window]:
                top, left = r - size // 2, c - size // 2
                if steps[r, c] < size or min(top, left) < 0 or top + size > height or left + size > width:
                    continue
                part = p[top : top + size, left : left + size]
                offset = np.arange(size) - (size - 1) / 2
                across, down = np.einsum("c,rca->a", offset, part), np.einsum("r,rca->a", offset, part)
                normal = np.cross(across, down)
                normal /= np.linalg.norm(normal)
                normals[r, c] = -normal if normal @ part[size // 2, size // 2] > 0 else normal
    return normals


def steps_to_an_edge(p: Rows) -> Rows:
    """Length of the shortest way to an edge, diagonal steps counting 1.4."""
    z = p[..., 2]
    edge: Rows = ~np.asarray(np.isfinite(p).all(axis=2))
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        with np.errstate(invalid="ignore"):
            jump = ~(np.abs(z[a] - z[b]) <= 0.04 * (np.abs(z[a]) + 1))
        edge[a] |= jump
        edge[b] |= jump
    rows, columns = np.nonzero(edge)
    v, u = np.mgrid[0 : p.shape[0], 0 : p.shape[1]]
    down, across = np.abs(v[..., None] - rows), np.abs(u[..., None] - columns)
    ways = np.maximum(down, across) + 0.4 * np.minimum(down, across)
    steps: Rows = ways.min(axis=2, initial=np.inf)
    return steps


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("seed", [0, 1])
def test_equals_the_reference(window: int, seed: int) -> None:
    cloud = bumpy(seed)
    found, expected = image_normals(cloud, window), reference(cloud, window)
    assert_array_equal(np.isfinite(found), np.isfinite(expected))
    assert np.isfinite(found).mean() > 0.5
    assert_allclose(found, expected, atol=2e-3)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_layout(layout: str) -> None:
    cloud = bumpy()
    assert image_normals(in_layout(cloud, layout)).tobytes() == image_normals(cloud).tobytes()


def test_a_plane_has_its_normal_everywhere() -> None:
    normal = np.array([0.3, -0.5, -0.8])
    v, u = np.mgrid[0:30, 0:40]
    rays = np.stack([(u - 20) / 60, (v - 15) / 60, np.ones_like(u)], axis=-1)
    found = image_normals(image(-1 / (rays @ normal)))
    known = np.isfinite(found[..., 0])
    assert known[5:-5, 5:-5].all()
    assert_allclose(found[known], np.tile(normal / np.linalg.norm(normal), (known.sum(), 1)), atol=1e-4)


def test_they_turn_with_the_cloud() -> None:
    v, u = np.mgrid[0:30, 0:40]
    cloud, T = image(1 + 0.05 * np.sin(u / 6) * np.cos(v / 9)), from_rpy([0, 0, 0], [0.2, 0.1, 1.0])
    assert_allclose(image_normals(transform_points(cloud, T)), image_normals(cloud) @ T[:3, :3].T, atol=1e-4)


@pytest.mark.parametrize("shape", [(2, 2), (3, 9), (12, 3), (2, 50)])
def test_small_images(shape: tuple[int, int]) -> None:
    found = image_normals(image(np.ones(shape)))
    inside = max(shape[0] - 2, 0) * max(shape[1] - 2, 0)
    assert np.isfinite(found[..., 0]).sum() == inside


def test_holes_and_far_points_tell_nothing() -> None:
    assert np.isnan(image_normals(image(np.full((20, 20), np.nan)))).all()
    depth = np.ones((40, 40))
    depth[20, 20] = 1e30
    found = image_normals(image(depth))
    assert_allclose(found[np.isfinite(found[..., 0])][:, 2], -1, atol=1e-5)


def test_bad_input_is_refused() -> None:
    cloud = bumpy()
    with pytest.raises(PointsError, match="rows and columns"):
        image_normals(cloud.reshape(1, -1))
    with pytest.raises(GeometryError, match="3 or more"):
        image_normals(cloud, 2)
    with pytest.raises(GeometryError, match="above zero"):
        image_normals(cloud, depth_change=np.nan)
    with pytest.raises(PointsError, match="output"):
        image_normals(cloud, out=np.empty((2, 2, 3), np.float32))
