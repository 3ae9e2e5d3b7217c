from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.core.clouds import LAYOUTS, assert_same_points, coordinates, in_layout, random_cloud

from zsight_core.errors import GeometryError, PointsError
from zsight_core.plane import (
    Plane,
    fit_robust,
    frame_on_plane,
    heights,
    inliers,
    plane_through,
    ransac_plane,
    select,
)
from zsight_core.points import from_xyz
from zsight_core.transform import from_rpy, transform_xyz

Rows = np.ndarray[Any, np.dtype[Any]]


def angle(a: Plane, b: Plane) -> float:
    """Angle between two normals, degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a.normal, b.normal)), a.normal @ b.normal)))


def table(rng: np.random.Generator, count: int, noise: float = 0.002) -> tuple[Plane, Rows, Rows]:
    """A tilted table one metre off, the points (count, 3) upon it, and the pose T_camera_table."""
    T = from_rpy([0.05, 0.1, 1.0], [np.pi - 0.9, 0.1, 0.3])
    flat = np.column_stack([rng.uniform(-0.2, 0.2, (count, 2)), rng.normal(0, noise, count)])
    return plane_through(T[:3, 2], T[:3, 3]), transform_xyz(T, flat), T


def of_all_triples(rows: Rows, threshold: float) -> Rows:
    """(4,) plane through three of the points with the least truncated squares (MSAC), each combination tried."""
    a, b, c = (rows[np.array(corner)] for corner in zip(*combinations(range(len(rows)), 3), strict=True))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distances = (normals * a).sum(axis=1)
    cost = np.minimum((normals @ rows.T - distances[:, np.newaxis]) ** 2, threshold**2).sum(axis=1)
    best = int(cost.argmin())
    return np.array([*normals[best], distances[best]])


def refitted(rows: Rows, plane: Rows, tolerance: float, rounds: int) -> tuple[Rows, int]:
    """The plane of least squares through the points near it, again and again; and to how many it was fitted."""
    near = rows
    for _ in range(rounds):
        near = rows[np.abs(rows @ plane[:3] - plane[3]) <= tolerance]
        centre = near.mean(axis=0)
        normal = np.linalg.svd(near - centre)[2][2]
        plane = np.array([*normal, normal @ centre])
    return (-plane if plane[3] > 0 else plane), len(near)


@pytest.mark.parametrize("seed", range(6))
def test_fits_equal_the_search_of_all_triples(seed: int) -> None:
    rng, threshold = np.random.default_rng(seed), 0.01
    _, on, _ = table(rng, 26)
    rows = np.concatenate([on, on[:12] + rng.uniform(-0.15, 0.15, (12, 3))]).astype(np.float32)
    exact = rows.astype(np.float64)
    plane, count = refitted(exact, of_all_triples(exact, threshold), threshold, 5)
    fit = ransac_plane(rows, threshold)
    assert fit.inliers == count
    assert_allclose(fit.plane.coefficients(), plane, atol=1e-5)
    off = np.abs(exact @ plane[:3] - plane[3])
    noise = 2.5 * 1.4826 * np.median(off[off <= threshold])
    plane, count = refitted(exact, plane, min(threshold, noise), 2)
    fit = fit_robust(rows, threshold)
    assert fit.inliers == count
    assert_allclose(fit.plane.coefficients(), plane, atol=1e-5)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31))
def test_normal_faces_the_origin_and_distance_is_negative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal, point = rng.normal(size=3), rng.normal(size=3)
    plane = plane_through(normal, point)
    assert np.linalg.norm(plane.normal) == pytest.approx(1)
    assert plane.distance <= 0
    assert plane.normal @ point == pytest.approx(plane.distance)
    assert abs(plane.normal @ normal) == pytest.approx(np.linalg.norm(normal))


def test_exact_plane_is_found_exactly() -> None:
    rng = np.random.default_rng(0)
    truth, points, _ = table(rng, 500, noise=0.0)
    for fit in (fit_robust(points), ransac_plane(points, 0.005)):
        assert angle(fit.plane, truth) < 1e-4
        assert fit.plane.distance == pytest.approx(truth.distance, abs=1e-6)
        assert fit.inliers == 500
        assert fit.rms < 1e-6


@pytest.mark.parametrize("share", [0.0, 0.2, 0.35, 0.45])
@pytest.mark.parametrize("shape", ["box", "ramp", "cloud"])
@pytest.mark.parametrize("seed", range(4))
def test_an_object_in_the_patch_hardly_turns_the_plane(share: float, shape: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, surface, T = table(rng, 2000)
    count = int(2000 * share / (1 - share))
    flat = rng.uniform([0.0, -0.2, 0.0], [0.2, 0.2, 0.1], (count, 3))
    if shape == "box":
        flat[: count // 2, 2] = 0.06 + rng.normal(0, 0.002, count // 2)
        flat[count // 2 :, 0] = rng.normal(0, 0.002, count - count // 2)
    elif shape == "ramp":
        flat[:, 2] = flat[:, 0] * 0.5 + rng.normal(0, 0.002, count)
    fit = fit_robust(np.concatenate([surface, transform_xyz(T, flat)]))
    assert angle(fit.plane, truth) < 0.5
    assert abs(fit.plane.distance - truth.distance) < 0.001
    assert 0.0015 < fit.rms < 0.003


def test_same_seed_same_plane_and_other_seeds_hardly_differ() -> None:
    _, points, _ = table(np.random.default_rng(1), 3000)
    first, second = fit_robust(points, seed=4), fit_robust(points, seed=4)
    assert_array_equal(first.plane.normal, second.plane.normal)
    assert angle(first.plane, fit_robust(points, seed=5).plane) < 0.02


@pytest.mark.parametrize("layout", LAYOUTS)
def test_holes_and_layouts(layout: str) -> None:
    rng = np.random.default_rng(2)
    truth, points, _ = table(rng, 4000)
    points[rng.random(4000) < 0.9] = np.nan
    cloud = in_layout(from_xyz(points.reshape(40, 100, 3), np.zeros((40, 100, 3))), layout)
    assert angle(fit_robust(cloud).plane, truth) < 0.5


def test_plane_follows_a_rigid_motion() -> None:
    _, points, _ = table(np.random.default_rng(3), 2000)
    T = from_rpy([0.1, -0.2, 0.4], [0.2, 0.1, -0.3])
    before, after = fit_robust(points).plane, fit_robust(transform_xyz(T, points)).plane
    moved = plane_through(T[:3, :3] @ before.normal, transform_xyz(T, before.normal * before.distance))
    assert angle(moved, after) < 0.05
    assert moved.distance == pytest.approx(after.distance, abs=1e-4)


def test_what_determines_no_plane_is_refused() -> None:
    with pytest.raises(GeometryError, match="at least 3"):
        fit_robust(np.zeros((2, 3)))
    with pytest.raises(GeometryError, match="at least 3"):
        fit_robust(np.full((50, 3), np.nan))
    with pytest.raises(GeometryError, match="at least 3"):
        ransac_plane(np.empty((0, 3)), 0.01)
    with pytest.raises(GeometryError, match="one line"):
        fit_robust(np.linspace([0, 0, 1], [1, 1, 2], 100))
    with pytest.raises(GeometryError, match="one line"):
        fit_robust(np.ones((100, 3)))
    for threshold in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(GeometryError, match="threshold"):
            ransac_plane(np.eye(3), threshold)


def test_a_plane_through_three_points() -> None:
    fit = ransac_plane(np.array([[0, 0, 2], [1, 0, 2], [0, 1, 2.0]]), 0.01)
    assert_allclose(fit.plane.normal, [0, 0, -1], atol=1e-9)
    assert fit.plane.distance == pytest.approx(-2)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_inliers_and_heights_equal_the_reference(layout: str) -> None:
    cloud = random_cloud(7, 31, 43)
    plane = plane_through([0.1, -0.5, -0.8], [0, 0, 1])
    rows = coordinates(cloud).astype(np.float64)
    with np.errstate(invalid="ignore"):
        expected = (rows @ plane.normal - plane.distance).reshape(cloud.shape)
    points = in_layout(cloud, layout)
    finite = np.isfinite(coordinates(cloud)).all(axis=1).reshape(cloud.shape)
    assert_allclose(heights(points, plane)[finite], expected[finite], atol=1e-6)
    near = inliers(points, plane, 0.1)
    clear = finite & (np.abs(np.abs(expected) - 0.1) > 1e-6)
    assert_array_equal(near[clear], np.abs(expected[clear]) <= 0.1)
    assert not near[~finite].any()
    chosen = select(points, plane, 0.1)
    assert chosen.dtype == points.dtype
    assert_same_points(chosen, points[near])


def test_tolerance_must_be_a_length() -> None:
    plane = Plane(np.array([0.0, 0, -1]), -1.0)
    for tolerance in (-0.1, np.nan):
        with pytest.raises(GeometryError, match="tolerance"):
            inliers(random_cloud(), plane, tolerance)
    with pytest.raises(PointsError):
        inliers(np.zeros((4, 2)), plane, 0.1)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31))
def test_frame_on_plane_is_the_books(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plane, point = plane_through(rng.normal(size=3), rng.normal(size=3)), rng.normal(size=3)
    T = frame_on_plane(plane, point)
    assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    assert_allclose(T[:3, 2], plane.normal)
    assert T[:3, 3] @ plane.normal == pytest.approx(plane.distance)
    assert_allclose(np.cross(T[:3, 3] - point, plane.normal), 0, atol=1e-9)
    assert T[0, 0] >= 0  # x leans the way of the camera's x
    assert T[0, 1] == pytest.approx(0, abs=1e-9)  # and y has nothing of it


def test_frame_on_a_plane_across_the_cameras_x_axis() -> None:
    T = frame_on_plane(plane_through([1, 0, 0], [2, 0, 0]), np.array([2.0, 3.0, 4.0]))
    assert_allclose(T, [[0, 0, -1, 2], [0, 1, 0, 3], [1, 0, 0, 4], [0, 0, 0, 1]], atol=1e-12)
