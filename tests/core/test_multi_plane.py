from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.core import book_scene as book
from tests.core import plain_planes
from tests.core.clouds import LAYOUTS, in_layout

from zsight_core.errors import GeometryError, PointsError
from zsight_core.files import pcd
from zsight_core.multi_plane import planes_of_image
from zsight_core.points import from_xyz, xyz
from zsight_core.rigid import transform_points
from zsight_core.simulation.kinect import Kinect
from zsight_core.transform import from_rpy

if TYPE_CHECKING:
    from pathlib import Path

    from zsight_core.points import Points

Labels = np.ndarray[Any, np.dtype[Any]]

PLANES = np.array([[0, -0.8, -0.6, -0.8], [0, -0.8, -0.6, -0.7], [0, 0, -1, -1.6]])
"""A floor, the top of a box 10 cm above it, and a wall: nx ny nz d."""


def room(noise: float = 0.0, seed: int = 0, height: int = 160, width: int = 200) -> tuple[Points, Labels]:
    """A floor with a box's top above it before a wall, as a camera sees them, and which is seen where."""
    v, u = np.mgrid[0:height, 0:width]
    rays = np.stack([(u - width / 2) / 180, (v - height / 2) / 180, np.ones((height, width))], axis=-1)
    depths = PLANES[:, 3, None, None] / np.moveaxis(rays @ PLANES[:, :3].T, 2, 0)
    depths[depths <= 0] = np.inf
    depths[1][(u < 60) | (u > 120) | (v < 90) | (v > 140)] = np.inf
    truth = depths.argmin(axis=0)
    depth = depths.min(axis=0)
    depth += np.random.default_rng(seed).normal(0, 1, depth.shape) * noise * depth**2
    return from_xyz(rays * depth[..., None]), truth


def overlap(found: Labels, truth: Labels) -> list[float]:
    """For each true plane, the best intersection over union that a found one has with it."""
    return [
        max(((truth == k) & (found == j)).sum() / ((truth == k) | (found == j)).sum() for j in range(found.max() + 1))
        for k in range(truth.max() + 1)
    ]


def agree_with_the_reference(cloud: Points, least: int = 1000) -> None:
    """The same planes, and the same pixels but for those whose normal or distance is, in float32, as at a threshold."""
    found, (labels, planes) = planes_of_image(cloud, least), plain_planes.planes_of_image(cloud, least)
    assert planes.size > 0
    assert_allclose([fit.plane.coefficients() for fit in found.fits], planes, atol=1e-4)
    assert (found.labels != labels).mean() < 1e-3


@pytest.mark.parametrize("noise", [0.0, 5e-4, 1e-3, 3e-3])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_room_equals_the_reference(noise: float, seed: int) -> None:
    agree_with_the_reference(room(noise, seed)[0], 600)


@pytest.mark.parametrize("noise", [None, Kinect()])
def test_a_table_equals_the_reference(noise: Kinect | None) -> None:
    agree_with_the_reference(
        book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK), (book.COKE_CAN, book.at(0.7, -0.1, 0.8357)), noise=noise)
    )


@pytest.mark.parametrize(
    "name", ["pcl/milk_cartoon_all_small_clorox.pcd", "mosd_learn/learn0.pcd", "moveit/drinks_can.pcd"]
)
def test_recordings_equal_the_reference(shared_data: Path, name: str) -> None:
    agree_with_the_reference(pcd.read(shared_data / name).points)


@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_finds_every_plane(noise: float) -> None:
    cloud, truth = room(noise)
    found = planes_of_image(cloud, least=600)
    assert len(found.fits) == 3
    assert min(overlap(found.labels, truth)) > 0.93
    assert [fit.inliers for fit in found.fits] == [(found.labels == k).sum() for k in range(3)]
    assert sorted(fit.inliers for fit in found.fits)[::-1] == [fit.inliers for fit in found.fits]
    for k, fit in enumerate(found.fits):
        true = PLANES[np.bincount(truth[found.labels == k]).argmax()]
        assert fit.plane.normal @ true[:3] > math.cos(math.radians(0.5))
        assert fit.plane.distance == pytest.approx(true[3], abs=2e-3)
        assert fit.rms <= 3 * noise + 1e-6


def test_labelled_points_lie_on_their_plane() -> None:
    cloud, _ = room(0.001)
    found = planes_of_image(cloud, least=600)
    for k, fit in enumerate(found.fits):
        assert np.abs(xyz(cloud)[found.labels == k] @ fit.plane.normal - fit.plane.distance).max() < 0.03


@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_layout(layout: str) -> None:
    cloud, _ = room(0.001)
    assert_array_equal(planes_of_image(in_layout(cloud, layout)).labels, planes_of_image(cloud).labels)


def test_a_moved_cloud_has_the_same_planes() -> None:
    cloud, _ = room(0.0005)
    T = from_rpy([0.1, 0.0, 0.0], [0.0, 0.0, 0.5])  # about the line of sight: depths stay
    before, after = planes_of_image(cloud), planes_of_image(transform_points(cloud, T))
    assert (before.labels != after.labels).mean() < 0.01
    for one, other in zip(before.fits, after.fits, strict=True):
        assert other.plane.normal @ T[:3, :3] @ one.plane.normal > math.cos(math.radians(0.2))


def test_pieces_of_one_surface_become_one_plane() -> None:
    """A floor that noise breaks up, with a seam whose normals agree with neither side."""
    cloud, _ = room(0.003, height=120, width=160)
    cloud["z"][:, 80:82] += 0.012
    found = planes_of_image(cloud[60:], least=300)
    assert (found.labels == 0).mean() > 0.8


def test_parallel_planes_stay_apart() -> None:
    v, u = np.mgrid[0:80, 0:100]
    depth = np.where(u < 50, 1.0, 1.05)
    cloud = from_xyz(np.stack([(u - 50) / 90 * depth, (v - 40) / 90 * depth, depth], axis=-1))
    labels = planes_of_image(cloud, least=500).labels
    assert len(np.unique(labels[:, 5:45])) == len(np.unique(labels[:, 55:95])) == 1
    assert labels[40, 20] != labels[40, 80]


def test_a_ball_is_no_plane() -> None:
    v, u = np.mgrid[0:120, 0:120]
    square = 0.16 - ((u - 60) / 150) ** 2 - ((v - 60) / 150) ** 2
    z = np.where(square > 0, 1.5 - np.sqrt(np.maximum(square, 0)), np.nan)
    found = planes_of_image(from_xyz(np.stack([(u - 60) / 150, (v - 60) / 150, z], axis=-1)))
    assert found.fits == ()
    assert (found.labels == -1).all()


@pytest.mark.parametrize("shape", [(2, 2), (3, 200), (200, 3), (9, 9), (16, 18)])
def test_small_and_empty_images(shape: tuple[int, int]) -> None:
    for depth in (1.0, np.nan, np.inf):
        v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
        cloud = from_xyz(np.stack([u * 0.01 + 0 * depth, v * 0.01, np.full(shape, depth)], axis=-1))
        found = planes_of_image(cloud, least=1)
        assert found.labels.shape == shape
        assert (found.labels >= 0).any() == (depth == 1.0 and min(shape) >= 16)


def test_bad_input_is_refused() -> None:
    cloud, _ = room()
    with pytest.raises(PointsError, match="rows and columns"):
        planes_of_image(cloud.reshape(1, -1))
    for thresholds in ((0, 0.05, 0.02, 0.02), (9, 0.0, 0.02, 0.02), (9, 0.05, np.nan, 0.02), (9, 0.05, 0.02, -1.0)):
        with pytest.raises(GeometryError, match="above zero"):
            planes_of_image(cloud, *thresholds)
