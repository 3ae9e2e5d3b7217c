from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from tests.core.clouds import LAYOUTS, finite, in_layout, random_cloud

from zsight_core.moments import moments_near_plane, plane_of_sums, principal_axes
from zsight_core.words import words_of

Rows = np.ndarray[Any, np.dtype[np.float64]]

PLANE = np.array([0.6, 0.0, -0.8, -0.7])


def reference(rows: Rows, tolerance: float) -> Rows:
    """Count, sums and sums of products of the points near the plane, about its point nearest to the origin."""
    near = rows[np.abs(rows @ PLANE[:3] - PLANE[3]) <= tolerance] - PLANE[:3] * PLANE[3]
    products = near.T @ near
    return np.array([len(near), *near.sum(axis=0), *products[np.triu_indices(3)]])


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("tolerance", [0.0, 0.1, math.inf])
def test_sums_equal_the_reference(layout: str, tolerance: float) -> None:
    cloud = random_cloud(3)
    words = words_of(in_layout(cloud, layout))
    found = moments_near_plane(words.words, words.layout, PLANE, tolerance)
    assert_allclose(found, reference(finite(cloud).astype(np.float64), tolerance), rtol=1e-6, atol=1e-4)


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.sampled_from([1e-4, 0.01, 0.5]))
def test_the_plane_is_that_of_the_singular_vectors(seed: int, thickness: float) -> None:
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rows = rng.normal(0, [1.0, 0.8, thickness], (60, 3)) @ turn + rng.uniform(1, 2, 3)
    products = rows.T @ rows
    plane, variances = plane_of_sums(np.array([len(rows), *rows.sum(axis=0), *products[np.triu_indices(3)]]))
    centre = rows.mean(axis=0)
    _, spreads, axes = np.linalg.svd(rows - centre)
    assert abs(plane[:3] @ axes[2]) == pytest.approx(1, abs=1e-6)
    assert plane[:3] @ centre == pytest.approx(plane[3], abs=1e-6)
    assert plane[3] <= 0
    assert_allclose(variances, spreads[::-1] ** 2 / len(rows), rtol=1e-5, atol=1e-12)


@settings(max_examples=40)
@given(
    st.integers(0, 2**31), st.sampled_from([(1.0, 2.0, 3.0), (1.0, 1.0, 1.0), (0.0, 0.0, 5.0), (1e-9, 1.0, 1.0 + 1e-9)])
)
def test_axes_are_the_eigenvectors(seed: int, variances: tuple[float, float, float]) -> None:
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    spread = turn @ np.diag(variances) @ turn.T
    found, axes = principal_axes((spread + spread.T) / 2)
    assert_allclose(found, np.linalg.eigvalsh(spread), atol=1e-12)
    assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert_allclose(axes @ np.diag(found) @ axes.T, spread, atol=1e-12)
