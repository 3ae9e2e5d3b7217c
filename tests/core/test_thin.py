"""Fewer points for the eye, never more than asked for."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from zsight_core.colour_map import graded, spread
from zsight_core.points import from_xyz
from zsight_core.thin import thin


@given(height=st.integers(1, 40), width=st.integers(1, 60), most=st.integers(1, 500), seed=st.integers(0, 9))
def test_no_more_than_asked_for_and_all_of_the_cloud(height: int, width: int, most: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(height, width, 3)).astype(np.float32)
    xyz[rng.random((height, width)) < 0.3] = np.nan
    points, coordinates = thin(from_xyz(xyz), most)
    assert len(points) == len(coordinates) <= most
    assert np.isfinite(coordinates).all()
    rows = {tuple(row) for row in xyz.reshape(-1, 3)[np.isfinite(xyz.reshape(-1, 3)).all(axis=1)].tolist()}
    assert {tuple(row) for row in coordinates.tolist()} <= rows
    if height * width <= most:
        assert len(points) == len(rows)


def test_a_large_image_uses_most_of_its_budget() -> None:
    points, _ = thin(from_xyz(np.zeros((480, 640, 3))), 60_000)
    assert 45_000 < len(points) <= 60_000


def test_colours_grow_lighter_with_the_value() -> None:
    lightness = graded(np.linspace(0, 1, 50), 0, 1).astype(float) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) >= 0).all()
    np.testing.assert_array_equal(graded(np.array([-5.0, np.nan]), 0, 1), graded(np.array([0.0, 0.0]), 0, 1))


def test_the_spread_leaves_outliers_and_holes_out() -> None:
    values = np.concatenate([np.linspace(1, 2, 1000), [np.nan, 1e6]])
    low, high = spread(values)
    assert 1.0 < low < 1.05
    assert 1.95 < high < 2.0
    assert spread(np.array([np.nan])) == (0.0, 1.0)
