"""The pinhole model and its fit to organised clouds."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsight_core import depth_image, pinhole
from zsight_core.errors import GeometryError, PointsError
from zsight_core.files import pcd
from zsight_core.pinhole import Distortion, Pinhole
from zsight_core.points import Points, from_xyz, xyz
from zsight_core.transform import from_rpy, transform_xyz

if TYPE_CHECKING:
    from pathlib import Path

LENS: Distortion = (0.1, -0.2, 0.001, -0.002, 0.05)
SIGNS = list(itertools.product((1, -1), repeat=3))


def scene(camera: Pinhole, seed: int = 0, holes: float = 0.3) -> Points:
    """Organised cloud of a bumpy wall with holes, as the camera sees it."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.5, 3, (camera.height, camera.width)).astype(np.float32)
    depth[rng.random(depth.shape) < holes] = np.nan
    return depth_image.to_points(depth, camera)


cameras = st.builds(
    Pinhole,
    width=st.integers(4, 40),
    height=st.integers(4, 40),
    fx=st.floats(5, 2000),
    fy=st.floats(5, 2000),
    cx=st.floats(-10, 50),
    cy=st.floats(-10, 50),
)


@given(cameras, st.sampled_from(SIGNS), st.integers(0, 100))
def test_the_fit_finds_the_camera_and_the_signs(camera: Pinhole, signs: tuple[int, int, int], seed: int) -> None:
    points = scene(camera, seed)
    for axis, sign in zip("xyz", signs, strict=True):
        points[axis] *= sign
    found = pinhole.fit(points)
    assert found.signs == signs
    assert found.holds()
    assert found.residual < 1e-2
    got, truth = found.pinhole, camera
    np.testing.assert_allclose([got.fx, got.fy], [truth.fx, truth.fy], rtol=1e-4)
    np.testing.assert_allclose([got.cx, got.cy], [truth.cx, truth.cy], atol=1e-2)
    assert (got.width, got.height) == (truth.width, truth.height)


def test_noise_in_the_pixels_shows_in_the_residual() -> None:
    camera = Pinhole(64, 48, 60.0, 60.0, 31.5, 23.5)
    points = scene(camera)
    rng = np.random.default_rng(1)
    for axis in "xy":
        points[axis] += (rng.normal(0, 0.1, points.shape) * points["z"] / 60).astype(np.float32)
    found = pinhole.fit(points)
    assert 0.12 < found.residual < 0.16  # 0.1 px in each of two axes


@pytest.mark.parametrize("change", ["moved", "transposed", "shuffled"])
def test_a_cloud_that_is_no_pinholes_is_told_by_its_residual(change: str) -> None:
    points = scene(Pinhole(64, 48, 60.0, 60.0, 31.5, 23.5))
    if change == "moved":
        points = from_xyz(transform_xyz(from_rpy([0.5, 0, 1], [-1.9, 0, -1.57]), xyz(points)))
    elif change == "transposed":
        points = np.ascontiguousarray(points.T)
    else:
        points = np.random.default_rng(2).permutation(points.reshape(-1)).reshape(points.shape)
    found = pinhole.fit(points)
    assert not found.holds()
    assert found.residual > 5


@pytest.mark.parametrize(
    ("name", "focal", "centre", "signs"),
    [
        ("mosd_learn/learn0.pcd", 525, (319.5, 239.5), (1, 1, 1)),
        ("pcl/milk_cartoon_all_small_clorox.pcd", 525, (319.5, 239.5), (1, -1, -1)),
        ("pcl/table_scene_mug_stereo_textured.pcd", 964.36, (319.81, 223.36), (1, 1, 1)),
        ("moveit/drinks_can.pcd", 525, (319.5, 239.5), (1, 1, 1)),
    ],
)
def test_recordings_have_their_published_intrinsics(
    shared_data: Path, name: str, focal: float, centre: tuple[float, float], signs: tuple[int, int, int]
) -> None:
    found = pinhole.fit(pcd.read(shared_data / name).points)
    np.testing.assert_allclose([found.pinhole.fx, found.pinhole.fy], focal, atol=0.01)
    np.testing.assert_allclose([found.pinhole.cx, found.pinhole.cy], centre, atol=0.01)
    assert found.signs == signs
    assert found.residual < 0.01


def test_a_fit_takes_an_organised_cloud_with_spread_points() -> None:
    with pytest.raises(PointsError, match="organised"):
        pinhole.fit(from_xyz(np.ones((1, 20, 3))))
    with pytest.raises(GeometryError, match="0 finite points"):
        pinhole.fit(from_xyz(np.full((4, 5, 3), np.nan)))
    with pytest.raises(GeometryError, match="do not spread"):
        pinhole.fit(from_xyz(np.ones((4, 5, 3))))
    row = scene(Pinhole(20, 20, 20.0, 20.0, 9.5, 9.5), holes=0)
    row["z"][1:] = np.nan
    with pytest.raises(GeometryError, match="one row or column"):
        pinhole.fit(row)


@pytest.mark.parametrize("lens", [None, LENS])
def test_what_a_pixels_ray_hits_falls_into_that_pixel(lens: Distortion | None) -> None:
    camera = Pinhole(64, 48, 60.0, 61.0, 30.5, 24.5, lens)
    rays = camera.rays()
    assert rays.shape == (48, 64, 2)
    points = np.concatenate([rays, np.ones((48, 64, 1))], axis=-1) * np.linspace(0.3, 5, 64)[:, np.newaxis]
    pixels = np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1)
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-6)


def test_distortion_is_that_of_the_plumb_bob_formula() -> None:
    x, y = 0.3, -0.2
    k1, k2, p1, p2, k3 = LENS
    r2 = x**2 + y**2
    bulge = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = 100 * (x * bulge + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)) + 50
    v = 110 * (y * bulge + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y) + 40
    camera = Pinhole(100, 80, 100.0, 110.0, 50.0, 40.0, LENS)
    np.testing.assert_allclose(camera.project(np.array([2 * x, 2 * y, 2])), [u, v], rtol=1e-12)


def test_points_behind_the_camera_have_no_pixel() -> None:
    camera = Pinhole(4, 4, 4.0, 4.0, 1.5, 1.5)
    assert np.isnan(camera.project(np.array([[0, 0, -1.0], [0, 0, 0], [0, 0, np.nan]]))).all()


def test_distortion_that_cannot_be_undone_gives_no_ray() -> None:
    folded = Pinhole(64, 48, 30.0, 30.0, 31.5, 23.5, (-0.5, 0.0, 0.0, 0.0, 0.0))
    rays = folded.rays()
    assert np.isnan(rays[0, 0]).all()
    assert np.isfinite(rays[24, 32]).all()


@pytest.mark.parametrize(
    "change", [{"width": 0}, {"height": -1}, {"fx": 0.0}, {"fy": -1.0}, {"cx": np.nan}, {"distortion": (np.inf,) * 5}]
)
def test_a_camera_that_makes_no_sense_is_refused(change: dict[str, Any]) -> None:
    facts: dict[str, Any] = {"width": 4, "height": 4, "fx": 4.0, "fy": 4.0, "cx": 1.5, "cy": 1.5}
    with pytest.raises(GeometryError, match="expected"):
        Pinhole(**(facts | change))
