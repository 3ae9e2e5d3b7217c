from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from tests.core.clouds import LAYOUTS, finite, in_layout, random_cloud

from zsight_core.errors import GeometryError
from zsight_core.points import from_xyz
from zsight_core.rigid import transform_points
from zsight_core.table_height import fit_slab, slab_counts, table_height
from zsight_core.transform import from_rpy, inverse, transform_xyz

T_WORLD_CAMERA = from_rpy([0.0, 0.0, 1.8], [-2.3, 0.0, 0.4])


def by_the_loop(z: np.ndarray[Any, np.dtype[np.float32]], low: float, high: float, slab: float) -> list[int]:
    """Counts by one filter a slab, as the book does it."""
    counts = []
    edge = low
    while edge < high:
        counts.append(int(((z >= np.float32(edge)) & (z <= np.float32(edge + slab))).sum()))
        edge += slab
    return counts


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(("low", "high", "slab"), [(0.6, 1.2, 0.005), (0.0, 2.0, 0.3), (0.5, 0.6, 0.5)])
def test_counts_equal_one_filter_a_slab(layout: str, low: float, high: float, slab: float) -> None:
    cloud = random_cloud(2, 60, 80)
    edges = [low]
    while edges[-1] < high:
        edges.append(edges[-1] + slab)
    counts = slab_counts(in_layout(cloud, layout), np.eye(4), np.array(edges))
    assert_array_equal(counts, by_the_loop(finite(cloud)[:, 2], low, high, slab))


def test_points_on_an_edge_count_on_both_sides() -> None:
    edges = np.array([0.0, 0.25, 0.5, 0.75])
    cloud = from_xyz([[0, 0, z] for z in (0.0, 0.25, 0.25, 0.5, 0.6, 0.75, 0.76, -0.01)])
    assert_array_equal(slab_counts(cloud, np.eye(4), edges), [3, 3, 3])


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.sampled_from([0.005, 0.01, 1 / 3]), st.floats(-3, 3))
def test_heights_a_rounding_from_an_edge_fall_where_the_filter_puts_them(seed: int, slab: float, low: float) -> None:
    rng = np.random.default_rng(seed)
    edges = [low]
    for _ in range(60):
        edges.append(edges[-1] + slab)
    z = rng.choice(edges, 700).astype(np.float32)
    for _ in range(2):
        z = np.where(rng.random(700) < 0.5, np.nextafter(z, np.float32(rng.choice([-9, 9])), dtype=np.float32), z)
    counts = slab_counts(from_xyz(np.column_stack([z, z, z])), np.eye(4), np.array(edges))
    assert_array_equal(counts, [((z >= np.float32(a)) & (z <= np.float32(b))).sum() for a, b in pairwise(edges)])


def room_with_table(seed: int = 0) -> tuple[Any, np.ndarray[Any, Any]]:
    """A table top at 0.775 m, 0.9 x 0.6 m, in the camera's frame, and clutter; also the table's points, world frame."""
    rng = np.random.default_rng(seed)
    top = np.column_stack([rng.uniform(-0.45, 0.45, 5000), rng.uniform(0.9, 1.5, 5000), rng.normal(0.775, 5e-4, 5000)])
    world = np.concatenate([top, rng.uniform([-1, 0, 0], [1, 2, 2], (3000, 3))])
    return from_xyz(transform_xyz(inverse(T_WORLD_CAMERA), world)), top


def test_finds_the_table() -> None:
    cloud, _ = room_with_table()
    assert table_height(cloud, T_WORLD_CAMERA, 0.6, 1.2) == pytest.approx(0.775, abs=0.004)


def test_a_region_hides_the_table() -> None:
    cloud, _ = room_with_table()
    elsewhere = (-1.0, 1.0, -np.inf, 0.5)
    heights = transform_points(cloud, T_WORLD_CAMERA)
    expected = by_the_loop(heights["z"][heights["y"] <= 0.5], 0.6, 1.2, 0.005)
    edges = np.array([0.6 + 0.005 * k for k in range(122)])
    counts = slab_counts(cloud, T_WORLD_CAMERA, edges, elsewhere)
    assert abs(int(counts.sum()) - sum(expected)) <= 2
    assert counts.max() < 50


def test_slab_fit_equals_the_reference() -> None:
    cloud, _ = room_with_table()
    world = transform_xyz(T_WORLD_CAMERA, finite(cloud).astype(np.float64))
    inside = world[(world[:, 2] >= 0.77) & (world[:, 2] <= 0.78)]
    fit = fit_slab(cloud, T_WORLD_CAMERA, 0.77, 0.78)
    assert abs(fit.count - len(inside)) <= 2
    assert_allclose(fit.centroid, inside.mean(axis=0), atol=1e-4)
    variances, axes = np.linalg.eigh(np.cov(inside.T, bias=True))
    assert_allclose(fit.spread, np.sqrt(variances), rtol=1e-2)
    assert abs(fit.plane.normal @ axes[:, 0]) == pytest.approx(1, abs=1e-5)
    assert abs(fit.major_axis @ axes[:, 2]) == pytest.approx(1, abs=1e-4)
    assert fit.plane.normal[2] > 0
    assert fit.plane.distance == pytest.approx(fit.plane.normal @ fit.centroid)
    assert abs(fit.major_axis[0]) > 0.99  # the table is longer along x


def test_what_holds_no_table_is_refused() -> None:
    cloud, _ = room_with_table()
    with pytest.raises(GeometryError, match="no point"):
        table_height(cloud, T_WORLD_CAMERA, 5, 6)
    with pytest.raises(GeometryError, match="low < high"):
        table_height(cloud, T_WORLD_CAMERA, 1.2, 0.6)
    with pytest.raises(GeometryError, match="low < high"):
        table_height(cloud, T_WORLD_CAMERA, 0.6, 1.2, 0.0)
    with pytest.raises(GeometryError, match="at least 3"):
        fit_slab(cloud, T_WORLD_CAMERA, 5, 6)
    with pytest.raises(GeometryError, match="one line"):
        fit_slab(from_xyz(np.linspace([0, 0, 0], [1, 1, 0], 9)), np.eye(4), -1, 1)
    with pytest.raises(GeometryError, match="no point"):
        table_height(random_cloud(holes=1.0), np.eye(4), 2, 3)
