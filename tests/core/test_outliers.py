from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from tests.core.clouds import LAYOUTS, assert_same_points, coordinates, in_layout, random_cloud

from zsight_core.errors import GeometryError
from zsight_core.outliers import remove_radius_outliers, remove_statistical_outliers
from zsight_core.points import from_xyz

Mask = np.ndarray[Any, np.dtype[Any]]


def crowded(xyz: Mask, radius: float, least: int) -> Mask:
    """Which points have so many others within the radius."""
    keep = np.zeros(len(xyz), np.bool_)
    index = np.flatnonzero(np.isfinite(xyz).all(axis=1))
    tree = cKDTree(xyz[index])
    keep[index] = tree.query_ball_point(xyz[index], radius, return_length=True) > least
    return keep


def usual(xyz: Mask, neighbours: int, deviations: float) -> Mask:
    """Which points have their neighbours no farther off than is usual."""
    keep = np.zeros(len(xyz), np.bool_)
    index = np.flatnonzero(np.isfinite(xyz).all(axis=1))
    dense = xyz[index].astype(np.float64)
    far = np.asarray(cKDTree(dense).query(dense, neighbours + 1)[0]).sum(axis=1) / neighbours
    keep[index] = far <= far.mean() + deviations * far.std(ddof=1)
    return keep


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from([0.05, 0.11, 0.3]), st.integers(1, 9))
def test_radius_equals_the_reference(seed: int, radius: float, least: int) -> None:
    cloud = random_cloud(seed, 10, 60)
    keep = crowded(coordinates(cloud), radius, least).reshape(cloud.shape)
    assert_same_points(remove_radius_outliers(cloud, radius, least), cloud[keep][np.newaxis])


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.integers(1, 40), st.sampled_from([-0.5, 0.0, 1.0]), st.booleans())
def test_statistical_equals_the_reference(seed: int, neighbours: int, deviations: float, sheet: bool) -> None:
    cloud = random_cloud(seed, 10, 60)
    if sheet:  # dense and thin, with points far off it
        cloud["x"][:8], cloud["y"][:8], cloud["z"][:8] = cloud["x"][:8] * 0.1, cloud["y"][:8] * 0.1, 1.0
    keep = usual(coordinates(cloud), neighbours, deviations).reshape(cloud.shape)
    assert_same_points(remove_statistical_outliers(cloud, neighbours, deviations), cloud[keep][np.newaxis])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_layout(layout: str) -> None:
    cloud = in_layout(random_cloud(1, 10, 60), layout)
    keep = crowded(coordinates(cloud), 0.2, 3).reshape(cloud.shape)
    assert_same_points(remove_radius_outliers(cloud, 0.2, 3), cloud[keep][np.newaxis])
    keep = usual(coordinates(cloud), 5, 0.5).reshape(cloud.shape)
    assert_same_points(remove_statistical_outliers(cloud, 5, 0.5), cloud[keep][np.newaxis])


def test_duplicates_are_neighbours_of_each_other() -> None:
    xyz = np.concatenate([np.tile([[0.5, 0.5, 1.0]], (6, 1)), [[3.0, 0, 1]]])
    assert remove_radius_outliers(from_xyz(xyz), 0.01, 5).size == 6
    assert remove_statistical_outliers(from_xyz(xyz), 3, 1.0).size == 6


def test_a_lone_far_point_goes() -> None:
    rng = np.random.default_rng(0)
    xyz = np.concatenate([rng.uniform(0, 1, (500, 3)), [[300.0, -200, 50]]])
    assert remove_statistical_outliers(from_xyz(xyz), 8, 3.0).size == 500
    assert remove_radius_outliers(from_xyz(xyz), 0.5, 1).size == 500


def test_a_point_too_far_for_float32_is_told() -> None:
    xyz = np.random.default_rng(0).uniform(0, 1, (200, 3))
    with pytest.raises(GeometryError, match="1e\\+20 m away"):
        remove_statistical_outliers(from_xyz(np.concatenate([xyz, [[1e20, 0, 0]]])), 2, 1.0)
    far = from_xyz(np.concatenate([xyz, [[9e17, 0, 0]]]))
    assert remove_statistical_outliers(far, 2, 1.0).size == 200


def test_room_that_is_given_is_used() -> None:
    cloud = random_cloud()
    room = np.empty((1, cloud.size), cloud.dtype)
    assert np.shares_memory(remove_radius_outliers(cloud, 0.3, 2, room), room)
    assert np.shares_memory(remove_statistical_outliers(cloud, 5, 1.0, room), room)


def test_nothing_and_nonsense() -> None:
    empty = random_cloud(holes=1.0)
    assert remove_radius_outliers(from_xyz(np.full((4, 3), np.nan)), 0.1, 1).size == 0
    for radius, least in ((0.0, 1), (np.nan, 1), (np.inf, 1), (0.1, 0)):
        with pytest.raises(GeometryError, match="above zero"):
            remove_radius_outliers(random_cloud(), radius, least)
    for neighbours, deviations in ((0, 1.0), (10**6, 1.0), (5, np.nan)):
        with pytest.raises(GeometryError, match="neighbours"):
            remove_statistical_outliers(random_cloud(), neighbours, deviations)
    with pytest.raises(GeometryError, match="neighbours"):
        remove_statistical_outliers(empty, 3, 1.0)
