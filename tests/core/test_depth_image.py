"""Depth images to organised clouds and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsight_core import depth_image, pinhole
from zsight_core.errors import PointsError
from zsight_core.files import pcd
from zsight_core.pinhole import Distortion, Pinhole
from zsight_core.points import XYZ, XYZRGB, colours, from_xyz, xyz

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

LENS: Distortion = (0.1, -0.2, 0.001, -0.002, 0.05)
CAMERA = Pinhole(32, 24, 30.0, 31.0, 15.5, 11.5)
BENT = Pinhole(32, 24, 30.0, 31.0, 15.5, 11.5, LENS)


@given(st.integers(0, 1000), st.sampled_from([0.001, 0.0001, 0.00025]), st.sampled_from([CAMERA, BENT]))
def test_integer_depth_comes_back(seed: int, scale: float, camera: Pinhole) -> None:
    depth = np.random.default_rng(seed).integers(0, 65536, (24, 32), dtype=np.uint16)
    depth[:, ::5] = 0
    points = depth_image.to_points(depth, camera, depth_scale=scale)
    np.testing.assert_array_equal(np.isnan(points["z"]), depth == 0)
    np.testing.assert_array_equal(depth_image.from_points(points, camera, depth_scale=scale), depth)


@given(st.integers(0, 1000), st.sampled_from(["<f4", "<f8"]), st.sampled_from([CAMERA, BENT]))
def test_float_depth_comes_back(seed: int, kind: str, camera: Pinhole) -> None:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.1, 10, (24, 32)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = np.nan
    points = depth_image.to_points(depth.astype(kind), camera)
    np.testing.assert_array_equal(depth_image.from_points(points, camera), depth)


@pytest.mark.parametrize("camera", [CAMERA, BENT])
def test_points_lie_on_their_pixels_rays(camera: Pinhole) -> None:
    depth = np.random.default_rng(0).uniform(0.5, 3, (24, 32))
    points = depth_image.to_points(depth, camera)
    expected = np.concatenate([camera.rays(), np.ones((24, 32, 1))], axis=-1) * depth[..., np.newaxis]
    np.testing.assert_allclose(xyz(points), expected, rtol=2e-6, atol=1e-7)
    assert points.dtype == XYZ


def test_depth_that_is_no_distance_is_a_hole_and_keeps_its_colour() -> None:
    depth = np.full((24, 32), 1.0, np.float32)
    depth[0, :5] = [np.nan, np.inf, -np.inf, 0, -1]
    rgb = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    points = depth_image.to_points(depth, CAMERA, colour=rgb)
    assert points.dtype == XYZRGB
    assert np.isnan(xyz(points)).all(axis=-1).sum() == 5
    assert np.isnan(xyz(points)[0, :5]).all()
    np.testing.assert_array_equal(colours(points), rgb)


def test_the_nearest_point_of_a_pixel_is_seen() -> None:
    points = from_xyz(
        np.array([[0, 0, 2], [0, 0, 1], [0, 0, 3], [0, 0, -1], [9, 9, 1], [np.nan, 0, 1], [0, 0, np.inf]])
    )
    depth = depth_image.from_points(points, Pinhole(3, 3, 2.0, 2.0, 1.0, 1.0))
    assert depth[1, 1] == 1
    assert np.isnan(depth).sum() == 8


def nearest_by_pixel(rows: NDArray[np.float64], camera: Pinhole) -> NDArray[np.float64]:
    """Least depth (H, W) of the points that the lens throws onto each pixel, NaN where there are none."""
    k1, k2, p1, p2, k3 = camera.distortion or (0.0,) * 5
    z = rows[rows[:, 2] > 0, 2]
    x, y = (rows[rows[:, 2] > 0, :2] / z[:, np.newaxis]).T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = np.rint(camera.fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)) + camera.cx)
    v = np.rint(camera.fy * (y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y) + camera.cy)
    seen = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    depth = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(depth, (v[seen].astype(int), u[seen].astype(int)), z[seen])
    return np.where(np.isinf(depth), np.nan, depth)


@given(st.integers(0, 1000), st.sampled_from([CAMERA, BENT]))
def test_depth_of_any_cloud_equals_the_reference(seed: int, camera: Pinhole) -> None:
    rows = np.random.default_rng(seed).uniform([-1, -1, -0.5], [1, 1, 3], (2000, 3)).astype(np.float32)
    expected = nearest_by_pixel(rows.astype(np.float64), camera)
    np.testing.assert_array_equal(depth_image.from_points(from_xyz(rows), camera), expected.astype(np.float32))


def test_distances_beyond_16_bits_are_holes() -> None:
    points = from_xyz([[0, 0, 65.535], [1, 0, 65.6]])
    depth = depth_image.from_points(points, Pinhole(2, 1, 65.6, 65.6, 0.0, 0.0), depth_scale=0.001)
    assert depth.tolist() == [[65535, 0]]


def test_an_output_is_filled_and_returned() -> None:
    rgb = np.zeros((24, 32, 3), np.uint8)
    depth = np.ones((24, 32), np.float32)
    out = np.empty((24, 32), XYZRGB)
    assert depth_image.to_points(depth, CAMERA, colour=rgb, out=out) is out
    assert out.tobytes() == depth_image.to_points(depth, CAMERA, colour=rgb).tobytes()


@pytest.mark.parametrize("name", ["mosd_learn/learn0.pcd", "pcl/table_scene_mug_stereo_textured.pcd"])
def test_recordings_come_back_from_their_depth_image(shared_data: Path, name: str) -> None:
    points = pcd.read(shared_data / name).points
    camera = pinhole.fit(points).pinhole
    depth = depth_image.from_points(points, camera)
    back = depth_image.to_points(depth, camera, colour=colours(points))
    np.testing.assert_array_equal(back["z"], np.where(np.isfinite(points["z"]), points["z"], np.nan))
    np.testing.assert_allclose(xyz(back), xyz(points), atol=3e-5)
    np.testing.assert_array_equal(colours(back), colours(points))


@pytest.mark.parametrize(
    ("depth", "options", "complaint"),
    [
        (np.zeros((24, 31), np.uint16), {}, "shape"),
        (np.zeros((24, 32, 1), np.uint16), {}, "shape"),
        (np.zeros((24, 32), np.int16), {}, "expected uint16 or float"),
        (np.zeros((24, 32), np.uint16), {"depth_scale": 0.0}, "scale"),
        (np.zeros((24, 32), np.uint16), {"depth_scale": np.nan}, "scale"),
        (np.zeros((24, 32), np.uint16), {"colour": np.zeros((24, 32), np.uint8)}, "colour image"),
        (np.zeros((24, 32), np.uint16), {"colour": np.zeros((24, 32, 3))}, "colour image"),
        (np.zeros((24, 32), np.uint16), {"out": np.zeros((24, 32), XYZRGB)}, "output"),
        (np.zeros((24, 32), np.uint16), {"out": np.zeros((32, 24), XYZ).T}, "output"),
    ],
)
def test_what_does_not_fit_is_refused(depth: Any, options: dict[str, Any], complaint: str) -> None:
    with pytest.raises(PointsError, match=complaint):
        depth_image.to_points(depth, CAMERA, **options)


@pytest.mark.parametrize("scale", [0.0, -1.0, np.inf])
def test_a_unit_that_is_none_is_refused(scale: float) -> None:
    with pytest.raises(PointsError, match="scale"):
        depth_image.from_points(from_xyz(np.ones((1, 3))), CAMERA, depth_scale=scale)
