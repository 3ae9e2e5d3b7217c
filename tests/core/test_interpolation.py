"""Laws of interpolation between rigid transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from zsight_core.interpolation import interpolate
from zsight_core.transform import angle_between, from_rpy

if TYPE_CHECKING:
    from numpy.typing import NDArray

angles = st.floats(-3.0, 3.0)
places = st.floats(-5.0, 5.0)
transforms = st.builds(
    lambda x, y, z, a, b, c: from_rpy((x, y, z), (a, b, c)), places, places, places, angles, angles, angles
)
fractions = st.floats(0.0, 1.0)


@given(transforms, transforms)
def test_the_ends_are_the_given_transforms(T_a: NDArray[np.float64], T_b: NDArray[np.float64]) -> None:
    np.testing.assert_allclose(interpolate(T_a, T_b, 0.0), T_a, atol=1e-9)
    np.testing.assert_allclose(interpolate(T_a, T_b, 1.0), T_b, atol=1e-9)


@given(transforms, transforms, fractions)
def test_the_result_is_rigid_and_turns_at_constant_speed(
    T_a: NDArray[np.float64], T_b: NDArray[np.float64], fraction: float
) -> None:
    T = interpolate(T_a, T_b, fraction)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    whole = angle_between(T_a, T_b)
    if whole < 3.1:  # two turns of half a circle are equally short
        np.testing.assert_allclose(angle_between(T_a, T), fraction * whole, atol=1e-5)
    np.testing.assert_allclose(T[:3, 3], (1 - fraction) * T_a[:3, 3] + fraction * T_b[:3, 3], atol=1e-9)


@given(transforms, transforms, fractions)
def test_there_and_back_meet(T_a: NDArray[np.float64], T_b: NDArray[np.float64], fraction: float) -> None:
    if angle_between(T_a, T_b) < 3.1:
        forth, back = interpolate(T_a, T_b, fraction), interpolate(T_b, T_a, 1 - fraction)
        np.testing.assert_allclose(forth, back, atol=1e-6)
