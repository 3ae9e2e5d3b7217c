from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from tests.core.clouds import LAYOUTS, coordinates, in_layout, random_cloud

from zsight_core.above_plane import above_mask
from zsight_core.clusters import clusters_above, euclidean_clusters, image_clusters
from zsight_core.errors import GeometryError, PointsError
from zsight_core.plane import plane_through
from zsight_core.points import from_xyz

Labels = np.ndarray[Any, np.dtype[Any]]


def reference(xyz: Labels, tolerance: float, least: int = 1) -> Labels:
    """Components of the graph of all pairs within the tolerance, the largest first."""
    index = np.flatnonzero(np.isfinite(xyz).all(axis=1))
    pairs = cKDTree(xyz[index].astype(np.float64)).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(index), len(index)))
    return ordered(index, connected_components(graph, directed=False)[1], len(xyz), least)


def ordered(index: Labels, component: Labels, count: int, least: int) -> Labels:
    """Components numbered by size, then by first point."""
    labels = np.full(count, -1)
    names, first, sizes = np.unique(component, return_index=True, return_counts=True)
    kept = [k for k in np.lexsort((first, -sizes)) if sizes[k] >= least]
    for number, k in enumerate(kept):
        labels[index[component == names[k]]] = number
    return labels


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.03, 0.08, 0.12, 0.3]), st.integers(1, 5))
def test_equals_the_graph(seed: int, tolerance: float, least: int) -> None:
    cloud = random_cloud(seed, 10, 60)
    labels = euclidean_clusters(cloud, tolerance, least)
    assert labels.shape == cloud.shape
    assert_array_equal(labels.reshape(-1), reference(coordinates(cloud), tolerance, least))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_layout(layout: str) -> None:
    cloud = random_cloud(1, 10, 60)
    assert_array_equal(euclidean_clusters(in_layout(cloud, layout), 0.1), euclidean_clusters(cloud, 0.1))


def test_dense_clumps() -> None:
    rng = np.random.default_rng(0)
    clumps = np.concatenate([rng.normal(centre, 0.01, (400, 3)) for centre in ([0, 0, 1], [0.2, 0, 1], [0.1, 0.3, 1])])
    rng.shuffle(clumps)
    xyz = clumps.astype(np.float32)
    assert_array_equal(euclidean_clusters(xyz, 0.02, 50)[0], reference(xyz, 0.02, 50))


def test_limits_on_size_and_a_mask() -> None:
    xyz = np.array([[0, 0, 1], [0.01, 0, 1], [0.02, 0, 1], [1, 0, 1], [2, 0, 1], [2.01, 0, 1]])
    assert_array_equal(euclidean_clusters(xyz, 0.015), [[0, 0, 0, 2, 1, 1]])
    assert_array_equal(euclidean_clusters(xyz, 0.015, least=2), [[0, 0, 0, -1, 1, 1]])
    assert_array_equal(euclidean_clusters(xyz, 0.015, least=2, most=2), [[-1, -1, -1, -1, 0, 0]])
    mask = np.array([[True, False, True, True, False, False]])
    assert_array_equal(euclidean_clusters(xyz, 0.015, mask=mask), [[0, -1, 1, 2, -1, -1]])


def test_above_a_plane() -> None:
    cloud = random_cloud(4, 20, 60)
    plane = plane_through([0, 0, -1], [0, 0, 1.2])
    expected = euclidean_clusters(cloud, 0.1, 3, mask=above_mask(cloud, plane, 0.1, 0.5))
    assert (expected >= 0).any()
    assert_array_equal(clusters_above(cloud, plane, 0.1, 0.5, 0.1, 3), expected)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31))
def test_order_of_points_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(0, 1, (300, 3)).astype(np.float32)
    order = rng.permutation(300)
    before, after = euclidean_clusters(xyz, 0.1)[0][order], euclidean_clusters(xyz[order], 0.1)[0]
    assert len(np.unique(np.stack([before, after]), axis=1).T) == len(np.unique(before)) == len(np.unique(after))


def image_reference(cloud: Any, mask: Labels, gap: float, least: int) -> Labels:
    rows = coordinates(cloud).reshape(*cloud.shape, 3)
    member = mask & np.isfinite(rows).all(axis=2)
    number = np.arange(cloud.size).reshape(cloud.shape)
    edges = []
    for a, b in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        with np.errstate(invalid="ignore"):
            near = member[a] & member[b] & (np.linalg.norm(rows[a] - rows[b], axis=2) <= gap)
        edges.append(np.stack([number[a][near], number[b][near]]))
    pairs = np.concatenate(edges, axis=1)
    component = connected_components(
        coo_array((np.ones(pairs.shape[1]), pairs), shape=(cloud.size,) * 2), directed=False
    )[1]
    index = np.flatnonzero(member)
    return ordered(index, component[index], cloud.size, least).reshape(cloud.shape)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.2, 0.5, 1.0]), st.integers(1, 4))
def test_image_clusters_equal_the_graph(seed: int, gap: float, least: int) -> None:
    cloud = random_cloud(seed, 12, 18)
    mask = np.asarray(np.random.default_rng(seed).random(cloud.shape) < 0.9)
    assert_array_equal(image_clusters(cloud, mask, gap, least), image_reference(cloud, mask, gap, least))


def test_nothing_and_nonsense() -> None:
    assert euclidean_clusters(np.empty((0, 3)), 0.1).shape == (1, 0)
    assert (euclidean_clusters(np.full((5, 3), np.nan), 0.1) == -1).all()
    cloud = random_cloud()
    for tolerance in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(GeometryError, match="longest step"):
            euclidean_clusters(cloud, tolerance)
        with pytest.raises(GeometryError, match="longest step"):
            image_clusters(cloud, np.ones(cloud.shape, np.bool_), tolerance)
    with pytest.raises(GeometryError, match="too small"):
        euclidean_clusters(np.array([[1e7, 0, 0]]), 0.01)
    with pytest.raises(GeometryError, match="lower one first"):
        clusters_above(cloud, plane_through([0, 0, 1], [0, 0, 1]), 2, 1, 0.1)
    with pytest.raises(PointsError, match="mask"):
        euclidean_clusters(cloud, 0.1, mask=np.ones((1, 1), np.bool_))
    with pytest.raises(PointsError, match="mask"):
        image_clusters(cloud, np.ones((1, 1), np.bool_), 0.1)
    assert_array_equal(euclidean_clusters(from_xyz([[1, 2, 3]]), 0.1), [[0]])
