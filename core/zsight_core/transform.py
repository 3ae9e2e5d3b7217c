"""Rigid transforms as 4 x 4 float64 matrices named T_target_source; quaternions are x, y, z, w; angles are radians."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import GeometryError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["angle_between", "from_quaternion", "from_rpy", "inverse", "quaternion", "transform_xyz"]


def from_quaternion(position: ArrayLike, orientation: ArrayLike) -> NDArray[np.float64]:
    """T (4, 4) from a position (3,), metres, and a quaternion x y z w (4,), normalised here.

    Raises:
        GeometryError: the quaternion is zero or not finite.
    """
    q = np.asarray(orientation, dtype=np.float64)
    length = float(np.linalg.norm(q)) if q.shape == (4,) else 0.0
    if not (np.isfinite(length) and length > 1e-9):
        raise GeometryError(f"quaternion {orientation!r} is not a rotation; expected x y z w of unit length")
    x, y, z, w = q / length
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, 3] = np.asarray(position, dtype=np.float64)
    return T


def from_rpy(position: ArrayLike, rpy: ArrayLike) -> NDArray[np.float64]:
    """T (4, 4) from a position (3,), metres, and roll, pitch, yaw (3,), radians, about fixed x, y, z in that order."""
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64) / 2
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    orientation = [
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    ]
    return from_quaternion(position, orientation)


def quaternion(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternion x y z w (4,) of the rotation in T (4, 4) or (3, 3), with w >= 0.

    Method: the largest of the four squared components first (Shepperd 1978), so that no root is near zero.
    """
    R = np.asarray(T, dtype=np.float64)[:3, :3]
    squares = np.array(
        [
            1 + R[0, 0] - R[1, 1] - R[2, 2],
            1 - R[0, 0] + R[1, 1] - R[2, 2],
            1 - R[0, 0] - R[1, 1] + R[2, 2],
            1 + R[0, 0] + R[1, 1] + R[2, 2],
        ]
    )
    products = np.array(
        [
            [squares[0], R[1, 0] + R[0, 1], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
            [R[1, 0] + R[0, 1], squares[1], R[2, 1] + R[1, 2], R[0, 2] - R[2, 0]],
            [R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], squares[2], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], squares[3]],
        ]
    )
    q: NDArray[np.float64] = products[int(np.argmax(squares))]
    q = q / np.linalg.norm(q)
    return -q if q[3] < 0 else q


def inverse(T_target_source: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_source_target (4, 4), by the transpose of the rotation."""
    T = np.eye(4)
    T[:3, :3] = T_target_source[:3, :3].T
    T[:3, 3] = -T[:3, :3] @ T_target_source[:3, 3]
    return T


def transform_xyz(T_target_source: NDArray[np.float64], xyz_source: NDArray[np.floating]) -> NDArray[np.floating]:
    """Points (..., 3), metres, moved from the source frame to the target frame; same shape and dtype."""
    moved = xyz_source @ T_target_source[:3, :3].T + T_target_source[:3, 3]
    return moved.astype(xyz_source.dtype, copy=False)


def angle_between(T_a: NDArray[np.float64], T_b: NDArray[np.float64]) -> float:
    """Angle of the rotation that leads from T_a to T_b, radians in [0, pi], accurate near 0 and pi."""
    R = T_a[:3, :3].T @ T_b[:3, :3]
    sine = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(sine, np.trace(R) - 1))
