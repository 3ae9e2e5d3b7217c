"""A rigid transform between two others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.transform import from_quaternion, quaternion

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["interpolate"]

_NEARLY_EQUAL = 1 - 1e-10  # cosine above which the arc is as good as its chord


def interpolate(T_a: NDArray[np.float64], T_b: NDArray[np.float64], fraction: float) -> NDArray[np.float64]:
    """The transform (4, 4) at a fraction 0..1 of the way from T_a to T_b.

    The translation goes along a straight line and the rotation along the shorter arc of unit quaternions at constant
    speed (slerp, Shoemake 1985).
    """
    q_a, q_b = quaternion(T_a), quaternion(T_b)
    cosine = float(q_a @ q_b)
    if cosine < 0:  # of the two quaternions of T_b the nearer one
        q_b, cosine = -q_b, -cosine
    if cosine > _NEARLY_EQUAL:
        turned = q_a + fraction * (q_b - q_a)
    else:
        angle = np.arccos(cosine)
        turned = (np.sin((1 - fraction) * angle) * q_a + np.sin(fraction * angle) * q_b) / np.sin(angle)
    return from_quaternion(T_a[:3, 3] + fraction * (T_b[:3, 3] - T_a[:3, 3]), turned)
