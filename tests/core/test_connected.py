from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from tests.core.clouds import coordinates, random_cloud

from zsight_core.connected import connected_to
from zsight_core.errors import GeometryError, PointsError
from zsight_core.points import from_xyz

Mask = np.ndarray[Any, np.dtype[np.bool_]]


def by_components(points: Any, member: Mask, patch: Mask, gap: float) -> Mask:
    """Graph of all pairs within the gap, components of it that touch the patch."""
    rows = coordinates(points).astype(np.float64)
    index = np.flatnonzero(member.reshape(-1) & np.isfinite(rows).all(axis=1))
    pairs = cKDTree(rows[index]).query_pairs(gap, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(index), len(index)))
    labels = connected_components(graph, directed=False)[1]
    touched = np.unique(labels[patch.reshape(-1)[index]])
    reached = np.zeros(points.size, np.bool_)
    reached[index[np.isin(labels, touched)]] = True
    return reached.reshape(points.shape)


@pytest.mark.parametrize("seed", range(5))
def test_unorganised_equals_the_graph(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cloud = random_cloud(seed, 1, 900)
    member, patch = rng.random((1, 900)) < 0.8, rng.random((1, 900)) < 0.01
    member &= np.isfinite(coordinates(cloud)).all(axis=1).reshape(1, -1)
    reached = connected_to(cloud, member, patch, 0.16)
    expected = by_components(cloud, member, patch, 0.16)
    assert 20 < expected.sum() < member.sum()
    assert_array_equal(reached, expected)


def two_tables() -> Any:
    """60 x 80 pixels at 1 m, 5 mm apart; columns 40..44 are missing, and the right part lies 20 cm lower."""
    v, u = np.mgrid[0:60, 0:80]
    xyz = np.stack([u * 0.005, v * 0.005, np.where(u < 42, 1.0, 1.2)], axis=-1)
    xyz[:, 40:45] = np.nan
    return from_xyz(xyz)


def test_organised_stops_at_a_step() -> None:
    cloud = two_tables()
    patch = np.zeros((60, 80), np.bool_)
    patch[5, 5] = True
    finite = np.isfinite(cloud["x"])
    reached = connected_to(cloud, finite, patch, 0.02)
    assert_array_equal(reached, finite & (np.arange(80) < 42))


def test_organised_crosses_a_hole_of_one_pixel_but_not_of_two() -> None:
    cloud = two_tables()
    member = np.isfinite(cloud["x"])
    patch = np.zeros((60, 80), np.bool_)
    patch[5, 5] = True
    member[:, 20] = False
    assert connected_to(cloud, member, patch, 0.02).sum() == 60 * 39
    member[:, 21] = False
    assert connected_to(cloud, member, patch, 0.02).sum() == 60 * 20


def test_organised_and_unorganised_agree_on_a_dense_surface() -> None:
    cloud = two_tables()
    member = np.isfinite(cloud["x"])
    patch = np.zeros((60, 80), np.bool_)
    patch[30, 70] = True
    flat = connected_to(cloud.reshape(1, -1), member.reshape(1, -1), patch.reshape(1, -1), 0.008)
    assert_array_equal(flat.reshape(60, 80), connected_to(cloud, member, patch, 0.008))


def test_a_patch_off_the_surface_reaches_nothing() -> None:
    cloud = two_tables()
    patch = np.zeros((60, 80), np.bool_)
    patch[:, 42] = True
    assert not connected_to(cloud, np.isfinite(cloud["x"]), patch).any()


def test_masks_and_gap_must_fit() -> None:
    cloud, mask = two_tables(), np.ones((60, 80), np.bool_)
    with pytest.raises(PointsError, match="mask"):
        connected_to(cloud, mask[1:], mask)
    with pytest.raises(PointsError, match="mask"):
        connected_to(cloud, mask, mask.astype(np.uint8))
    with pytest.raises(GeometryError, match="gap"):
        connected_to(cloud, mask, mask, 0.0)
