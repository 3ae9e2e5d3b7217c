from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from tests.core.clouds import LAYOUTS, assert_same_points, coordinates, in_layout, random_cloud

from zsight_core.errors import GeometryError, PointsError
from zsight_core.filters import box, box_mask, finite_mask, matching_colour, pass_through, remove_nan
from zsight_core.points import colours, from_xyz
from zsight_core.take import take


@pytest.mark.parametrize("layout", LAYOUTS)
def test_box_equals_the_reference(layout: str) -> None:
    cloud = random_cloud()
    low, high = np.array([-0.5, -0.3, 0.7], np.float32), np.array([0.9, 0.2, np.inf], np.float32)
    rows = coordinates(cloud)
    inside = ((rows >= low) & (rows <= high) & np.isfinite(rows)).all(axis=1).reshape(cloud.shape)
    points = in_layout(cloud, layout)
    assert_array_equal(box_mask(points, low, high), inside)
    assert_same_points(box(points, low, high), points[inside])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_remove_nan_keeps_what_is_finite_in_order(layout: str) -> None:
    cloud = random_cloud()
    finite = np.isfinite(coordinates(cloud)).all(axis=1).reshape(cloud.shape)
    points = in_layout(cloud, layout)
    assert_array_equal(finite_mask(points), finite)
    assert_same_points(remove_nan(points), points[finite])
    assert remove_nan(points).shape == (1, finite.sum())


def test_limits_belong_to_the_box() -> None:
    cloud = from_xyz([[1, 2, 3], [1, 2, 4]])
    assert box(cloud, [1, 2, 3], [1, 2, 3]).size == 1
    assert pass_through(cloud, "z", 3, 4).size == 2


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_pass_through_is_a_box_on_one_axis(axis: str) -> None:
    cloud = random_cloud()
    kept = coordinates(pass_through(cloud, axis, -0.2, 0.9))
    rows = coordinates(cloud)
    column = rows[:, "xyz".index(axis)]
    expected = rows[np.isfinite(rows).all(axis=1) & (column >= np.float32(-0.2)) & (column <= np.float32(0.9))]
    assert_array_equal(kept, expected)


def test_pass_through_of_another_field() -> None:
    cloud = in_layout(random_cloud(), "rgba")
    cloud["label"] = np.arange(cloud.size).reshape(cloud.shape)
    kept = pass_through(cloud, "label", 100, 200)
    assert kept["label"].min() >= 100
    assert kept["label"].max() <= 200
    assert kept.size == finite_mask(cloud).reshape(-1)[100:201].sum()


@pytest.mark.parametrize(("low", "high", "kept"), [(0.5, 2.7, [1, 2]), (-1, 2, [0, 1, 2]), (1, 300, [1, 2, 3])])
def test_limits_of_a_field_of_whole_numbers_may_be_any(low: float, high: float, kept: list[int]) -> None:
    cloud = np.zeros((1, 4), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("ring", "u1")])
    cloud["ring"] = range(4)
    assert pass_through(cloud, "ring", low, high)["ring"].ravel().tolist() == kept
    assert pass_through(cloud, "ring", -np.inf, high)["ring"].max() == kept[-1]


def test_matching_colour_equals_the_reference() -> None:
    cloud = random_cloud()
    near = (np.abs(colours(cloud).astype(int) - [100, 150, 200]) <= 60).all(axis=-1) & finite_mask(cloud)
    assert near.any()
    assert_same_points(matching_colour(cloud, (100, 150, 200), 60), cloud[near])


def test_wishes_that_make_no_sense_are_refused() -> None:
    cloud = random_cloud()
    with pytest.raises(PointsError, match="no 'w'"):
        pass_through(cloud, "w", 0, 1)
    with pytest.raises(GeometryError, match="lower one first"):
        pass_through(cloud, "x", 1, 0)
    with pytest.raises(GeometryError, match="lower one first"):
        box(cloud, [0, 0, 0], [1, np.nan, 1])
    with pytest.raises(PointsError, match="rgb"):
        matching_colour(from_xyz(np.zeros((2, 3))), (1, 2, 3), 4)
    with pytest.raises(PointsError, match="one"):
        pass_through(np.zeros((1, 1), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("v", "<f4", 2)]), "v", 0, 1)


def test_take_into_room_that_is_given() -> None:
    cloud, room = random_cloud(), np.empty((1, 960), random_cloud().dtype)
    mask = finite_mask(cloud)
    taken = take(cloud, mask, room)
    assert np.shares_memory(taken, room)
    assert_same_points(taken, cloud[mask])
    with pytest.raises(PointsError, match="or more"):
        take(cloud, mask, room[:, :5])
    with pytest.raises(PointsError, match="mask"):
        take(cloud, mask[1:])


def test_empty_clouds_stay_empty() -> None:
    empty = from_xyz(np.empty((0, 3)), np.empty((0, 3)))
    assert remove_nan(empty).shape == (1, 0)
    assert box(empty, [0, 0, 0], [1, 1, 1]).shape == (1, 0)
    assert remove_nan(random_cloud(holes=1.0)).shape == (1, 0)
