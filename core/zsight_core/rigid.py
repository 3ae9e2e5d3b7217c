"""Rigid motion of a cloud."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import GeometryError, PointsError
from zsight_core.jit import njit
from zsight_core.words import record_words, words_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.words import Layout

__all__ = ["transform_points", "warm_up"]

_NORMAL = ("normal_x", "normal_y", "normal_z")


def transform_points(points: Points, T_target_source: NDArray[np.float64], out: Points | None = None) -> Points:
    """Move a cloud from the source frame to the target frame; normals are turned with it.

    Args:
        points: (H, W), in the source frame.
        T_target_source: (4, 4) rotation and translation, metres.
        out: a contiguous cloud of the same shape and dtype to write into.

    Returns:
        Points of the same shape and dtype, in the target frame; holes stay holes.

    Raises:
        GeometryError: T is not rigid: not finite, or its rotation not orthonormal to 1e-6.
        PointsError: not a cloud, or `out` does not fit.
    """
    T = np.asarray(T_target_source, dtype=np.float64)
    _require_rigid(T)
    cloud = words_of(points)
    if out is None:
        out = np.empty(points.shape, points.dtype)
    if out.shape != points.shape or out.dtype != points.dtype or not out.flags.c_contiguous:
        raise PointsError(f"output is {out.shape} {out.dtype}; expected contiguous {points.shape} {points.dtype}")
    motion = T[:3].astype(np.float32)
    if np.shares_memory(cloud.words, points) and points.dtype.itemsize == 4 * cloud.layout[0]:
        _transform_words(cloud.words, cloud.layout, motion, record_words(out))
    else:
        _transform_fields(points, motion, ("x", "y", "z"), out)
    names = points.dtype.names or ()
    if all(name in names for name in _NORMAL):
        motion[:, 3] = 0
        _transform_fields(points, motion, _NORMAL, out, copy=False)
    return out


def _require_rigid(T: NDArray[np.float64]) -> None:
    rigid = T.shape == (4, 4) and bool(np.isfinite(T).all())
    if not rigid or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6) or np.linalg.det(T[:3, :3]) < 0:
        raise GeometryError(f"transform is not rigid; expected (4, 4), finite, with an orthonormal rotation, got\n{T}")


def _transform_fields(
    points: Points, motion: NDArray[np.float32], names: tuple[str, ...], out: Points, *, copy: bool = True
) -> None:
    """The slow way for layouts that are not made of words, and for normals."""
    if copy:
        out[...] = points
    rows = np.stack([points[name].astype(np.float64) for name in names], axis=-1)
    moved = rows @ motion[:, :3].T.astype(np.float64) + motion[:, 3]
    for column, name in enumerate(names):
        out[name] = moved[..., column]


@njit(cache=True, nogil=True)
def _transform_words(
    words: NDArray[np.float32], layout: Layout, motion: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    step, at_x, at_y, at_z = layout
    r00, r01, r02, t0 = motion[0, 0], motion[0, 1], motion[0, 2], motion[0, 3]
    r10, r11, r12, t1 = motion[1, 0], motion[1, 1], motion[1, 2], motion[1, 3]
    r20, r21, r22, t2 = motion[2, 0], motion[2, 1], motion[2, 2], motion[2, 3]
    if step == 4 and at_x == 0 and at_y == 1 and at_z == 2:
        for i in range(len(words) // 4):
            x, y, z = words[4 * i], words[4 * i + 1], words[4 * i + 2]
            last = words[4 * i + 3]
            out[4 * i] = r00 * x + r01 * y + r02 * z + t0
            out[4 * i + 1] = r10 * x + r11 * y + r12 * z + t1
            out[4 * i + 2] = r20 * x + r21 * y + r22 * z + t2
            out[4 * i + 3] = last
    else:
        out[:] = words
        for i in range(len(words) // step):
            x, y, z = words[step * i + at_x], words[step * i + at_y], words[step * i + at_z]
            out[step * i + at_x] = r00 * x + r01 * y + r02 * z + t0
            out[step * i + at_y] = r10 * x + r11 * y + r12 * z + t1
            out[step * i + at_z] = r20 * x + r21 * y + r22 * z + t2


def warm_up() -> None:
    """Compile the kernels of this file."""
    words = words_of(np.zeros((4, 3), np.float32))
    _transform_words(words.words, words.layout, np.eye(3, 4, dtype=np.float32), np.empty(12, np.float32))
