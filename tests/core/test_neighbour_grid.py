from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from tests.core.clouds import LAYOUTS, coordinates, in_layout, random_cloud

from zsight_core.errors import GeometryError
from zsight_core.neighbour_grid import block_around, grid_of
from zsight_core.points import from_xyz
from zsight_core.words import words_of

Rows = np.ndarray[tuple[int, ...], np.dtype[np.float32]]
Indices = np.ndarray[tuple[int, ...], np.dtype[np.intp]]


def sorted_into_cells(xyz: Rows, edge: float, mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Indices:
    """Which points take part, in the order of their cells: along x, then y, then z, then as they come."""
    index = np.flatnonzero(np.isfinite(xyz).all(axis=1) & mask)
    x, y, z = np.floor(xyz[index].astype(np.float64) * (1.0 / edge)).T
    return index[np.lexsort((index, x, y, z))]


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from([0.004, 0.05, 0.3, 5.0]), st.booleans())
def test_points_stand_cell_after_cell(seed: int, edge: float, some: bool) -> None:
    cloud = random_cloud(seed)  # at 4 mm each point has a cell of its own, more than there is room for at first
    mask = np.random.default_rng(seed).random(cloud.size) < (0.5 if some else 2)
    grid = grid_of(words_of(cloud), edge, mask if some else None)
    assert_array_equal(grid.order, sorted_into_cells(coordinates(cloud), edge, mask))
    assert_array_equal(grid.xyz.T, coordinates(cloud)[grid.order])
    cells = np.floor(grid.xyz.astype(np.float64) * (1.0 / edge)).T
    changes = 1 + np.flatnonzero((np.diff(cells, axis=0) != 0).any(axis=1))
    assert_array_equal(grid.starts, [0, *changes, len(cells)])
    assert (np.diff(grid.keys) > 0).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_layout(layout: str) -> None:
    cloud = random_cloud(1)
    one, other = (grid_of(words_of(points), 0.1) for points in (cloud, in_layout(cloud, layout)))
    assert one.order.tobytes() == other.order.tobytes()


def test_a_block_holds_the_points_of_27_cells() -> None:
    cloud, edge = random_cloud(2), 0.1
    grid = grid_of(words_of(cloud), edge)
    cell_of_point = np.floor(grid.xyz.astype(np.float64) * (1.0 / edge)).T
    rows, room = np.zeros(9, np.int64), np.empty((3, 0), np.float32)
    for cell in range(grid.cells):
        room, count = block_around(grid.xyz, grid.starts, grid.keys, cell, rows, room)
        near = (np.abs(cell_of_point - cell_of_point[grid.starts[cell]]) <= 1).all(axis=1)
        assert_array_equal(room[:, :count], grid.xyz[:, near])


def test_nothing_and_too_far() -> None:
    assert grid_of(words_of(np.full((3, 3), np.nan)), 0.1).cells == 0
    with pytest.raises(GeometryError, match="too small"):
        grid_of(words_of(from_xyz([[1e7, 0, 0]])), 0.01)
