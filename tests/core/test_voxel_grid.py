from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.core.clouds import LAYOUTS, coordinates, finite, in_layout, random_cloud

from zsight_core.errors import GeometryError
from zsight_core.points import colours, from_xyz
from zsight_core.voxel_grid import voxel_grid

Rows = np.ndarray[Any, np.dtype[Any]]


def reference(xyz: Rows, rgb: Rows, leaf: float | tuple[float, float, float]) -> tuple[Rows, Rows]:
    """Averages by numpy, in PCL's order of voxels (x fastest)."""
    inverse = np.float32(1) / np.broadcast_to(np.asarray(leaf, np.float32), 3)
    cells = np.floor(xyz.astype(np.float32) * inverse).astype(np.int64)
    order = np.lexsort((cells[:, 0], cells[:, 1], cells[:, 2]))
    starts = np.flatnonzero(np.any(np.diff(cells[order], axis=0, prepend=cells[order[:1]] - 1), axis=1))
    counts = np.diff(np.append(starts, len(order)))[:, None]
    means = np.add.reduceat(xyz[order].astype(np.float64), starts) / counts
    return means, np.add.reduceat(rgb[order].astype(np.int64), starts) // counts


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("leaf", [0.05, 0.3, (0.1, 0.4, 5.0), 100.0])
def test_equals_the_reference(layout: str, leaf: float | tuple[float, float, float]) -> None:
    cloud = random_cloud()
    keep = np.isfinite(coordinates(cloud)).all(axis=1)
    xyz, rgb = reference(coordinates(cloud)[keep], colours(cloud).reshape(-1, 3)[keep], leaf)
    voxels = voxel_grid(in_layout(cloud, layout), leaf)
    assert voxels.shape == (1, len(xyz))
    assert voxels.dtype == LAYOUTS[layout]
    assert_allclose(coordinates(voxels), xyz, atol=2e-6 + np.max(leaf) * 2**-21)
    name = "rgba" if layout == "rgba" else "rgb"
    bits = voxels[name].astype(voxels[name].dtype.newbyteorder("=")).view(np.uint32)[0]
    assert_array_equal(np.stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255], axis=-1), rgb)


def test_a_crowded_voxel_does_not_overflow() -> None:
    rng = np.random.default_rng(6)
    xyz = np.concatenate([rng.uniform(90, 99, (9000, 3)), [[-1.0, -1, -1]]]).astype(np.float32)
    rgb = rng.integers(200, 256, (9001, 3), dtype=np.uint8)
    means, colour = reference(xyz, rgb, 100.0)
    voxels = voxel_grid(from_xyz(xyz, rgb), 100.0)
    assert_allclose(coordinates(voxels), means, atol=2e-6 + 100 * 2**-21)
    assert_array_equal(colours(voxels)[0], colour)


def test_many_voxels_are_told_apart() -> None:
    rng = np.random.default_rng(3)
    xyz = rng.uniform(-5, 5, (60_000, 3)).astype(np.float32)
    rgb = rng.integers(0, 256, (60_000, 3), dtype=np.uint8)
    expected, _ = reference(xyz, rgb, 0.05)
    voxels = voxel_grid(from_xyz(xyz, rgb), 0.05)
    assert voxels.size == len(expected) > 50_000
    assert_allclose(coordinates(voxels), expected, atol=2e-6)


def test_a_wide_cloud_is_sorted_instead_of_mapped() -> None:
    rng = np.random.default_rng(4)
    xyz = rng.uniform(-1e4, 1e4, (3000, 3)).astype(np.float32)
    xyz[1000:] = xyz[:2000] + np.float32(0.01)
    rgb = rng.integers(0, 256, (3000, 3), dtype=np.uint8)
    means, colour = reference(xyz, rgb, 0.1)
    voxels = voxel_grid(from_xyz(xyz, rgb), 0.1)
    assert_allclose(coordinates(voxels), means, atol=1e-3)  # float32 is no finer 10 km away
    assert_array_equal(colours(voxels)[0], colour)


def test_a_point_with_a_hole_and_a_far_coordinate_is_a_hole() -> None:
    xyz = np.array([[np.nan, 1e9, 0], [0, np.inf, -1e9], [0.51, 0.5, 0.5]])
    assert voxel_grid(from_xyz(xyz[:2]), 0.01).size == 0
    assert_allclose(coordinates(voxel_grid(from_xyz(xyz), 0.01)), [[0.51, 0.5, 0.5]], atol=2e-6)


def test_a_far_point_leaves_near_ones_where_they_are() -> None:
    near = np.random.default_rng(5).uniform(-1, 1, (500, 3)).astype(np.float32)
    xyz = np.concatenate([near, [[400.0, 0, 0]]]).astype(np.float32)  # 20,000 voxels off
    means, _ = reference(xyz, np.zeros((501, 3), np.uint8), 0.02)
    assert_allclose(coordinates(voxel_grid(from_xyz(xyz), 0.02)), means, atol=2e-6 + 400 * 2**-24)


def test_room_that_is_given_is_used() -> None:
    cloud, room = random_cloud(), np.empty((1, 960), random_cloud().dtype)
    voxels = voxel_grid(cloud, 0.2, room)
    assert np.shares_memory(voxels, room)
    assert voxels.tobytes() == voxel_grid(cloud, 0.2).tobytes()


def test_alpha_is_averaged_too() -> None:
    cloud = from_xyz(np.zeros((2, 3)), np.zeros((2, 3), np.uint8))
    cloud["rgb"].view(np.uint32)[...] = [[0xFF102030, 0x80102030]]
    assert voxel_grid(cloud, 1.0)["rgb"].view(np.uint32)[0, 0] == 0xBF102030


def test_other_fields_are_averaged_and_integers_truncated() -> None:
    dtype = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("heat", "<f8"), ("ring", "<u2"), ("pair", "<f4", 2)])
    cloud = np.zeros((1, 3), dtype)
    cloud["x"] = [[0.1, 0.2, 5.0]]
    cloud["heat"] = [[1.0, 4.0, 7.0]]
    cloud["ring"] = [[3, 4, 9]]
    cloud["pair"] = [[[1, 2], [3, 6], [5, 5]]]
    voxels = voxel_grid(cloud, 1.0)
    assert_allclose(voxels["heat"], [[2.5, 7.0]])
    assert_array_equal(voxels["ring"], [[3, 9]])
    assert_allclose(voxels["pair"], [[[2, 4], [5, 5]]])


def test_nothing_in_nothing_out() -> None:
    assert voxel_grid(from_xyz(np.empty((0, 3))), 0.1).shape == (1, 0)
    assert voxel_grid(from_xyz(np.full((4, 5, 3), np.nan)), 0.1).shape == (1, 0)
    assert voxel_grid(in_layout(random_cloud(holes=1.0), "rgba"), 0.1).shape == (1, 0)


@pytest.mark.parametrize("leaf", [0.0, -0.1, np.nan, np.inf, (0.1, 0.0, 0.1)])
def test_leaf_must_be_a_length(leaf: float | tuple[float, float, float]) -> None:
    with pytest.raises(GeometryError, match="expected one length above zero"):
        voxel_grid(random_cloud(), leaf)


@pytest.mark.parametrize("far", [1e30, -1e30, 2e4, 1e10])
def test_a_grid_that_would_overflow_is_refused(far: float) -> None:
    with pytest.raises(GeometryError, match="too small for coordinates"):
        voxel_grid(from_xyz(np.array([[0, 0, 1], [far, 0, 1]])), 0.01)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.02, 0.11, 0.7]))
def test_order_of_points_does_not_matter(seed: int, leaf: float) -> None:
    cloud = random_cloud(seed, 6, 50)
    shuffled = cloud.reshape(-1)[np.random.default_rng(seed).permutation(cloud.size)].reshape(1, -1)
    first, second = voxel_grid(cloud, leaf), voxel_grid(shuffled, leaf)
    assert first.tobytes() == second.tobytes()


def test_tiny_negative_coordinates_stay_in_their_voxel() -> None:
    cloud = from_xyz(np.full((64, 3), -1e-9), np.zeros((64, 3)))  # the distance to the floor rounds to a whole edge
    assert_allclose(coordinates(voxel_grid(cloud, 0.1)), [[0, 0, 0]], atol=2e-6)


def test_duplicates_change_nothing() -> None:
    cloud = random_cloud()
    twice = np.concatenate([cloud, cloud], axis=1)
    assert voxel_grid(twice, 0.2).tobytes() == voxel_grid(cloud, 0.2).tobytes()


def test_each_average_lies_in_its_voxel() -> None:
    cloud = random_cloud(5, 50, 80)
    cells = np.floor(coordinates(voxel_grid(cloud, 0.25)) / 0.25)
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert len(cells) == len(np.unique(np.floor(finite(cloud) / 0.25), axis=0))
