"""Which points of a cloud an eye sees within a rectangle, with those left out that others stand in front of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Lens", "Rectangle", "visible"]

_NEAREST = 1e-3  # metres before the eye
_SLANT = 2.75  # tangent of the slant that every surface is granted (70 degrees); more where the buffer shows it
_REACH = 2.0  # cells between a point and the farthest that may hide it
_FINEST = 512  # cells across the picture at most, however dense the cloud is


@dataclass(frozen=True, eq=False)
class Lens:
    """A pinhole eye: T_eye_points (4, 4), optical axes; tangents of half its view, across and down."""

    T_eye_points: NDArray[np.float64]
    tangent_across: float
    tangent_down: float


@dataclass(frozen=True)
class Rectangle:
    """A part of the picture: left, top, right, bottom as shares (0 to 1) of its width and height."""

    left: float
    top: float
    right: float
    bottom: float


def visible(xyz: NDArray[np.floating], lens: Lens, part: Rectangle, disc: float) -> NDArray[np.bool_]:
    """Mask (N,) of the points that are seen within a part of the picture.

    Method: a z-buffer (Catmull 1974) whose cells are as wide as the discs appear at the median depth. The nearest
    depth of a cell and its eight neighbours hides what lies behind it by more than the surface spans there: its slope
    is the smaller one to both sides, so that a rim is none.

    Args:
        xyz: (N, 3), metres, in the frame of the points; holes are never seen.
        lens: the eye.
        part: the rectangle.
        disc: diameter of the disc that a point is drawn as, metres.
    """
    seen = xyz.astype(np.float64) @ lens.T_eye_points[:3, :3].T + lens.T_eye_points[:3, 3]
    before = np.flatnonzero(seen[:, 2] > _NEAREST)  # NaN compares false
    seen = seen[before]
    across = seen[:, 0] / seen[:, 2] / lens.tangent_across / 2 + 0.5
    down = seen[:, 1] / seen[:, 2] / lens.tangent_down / 2 + 0.5
    on_screen = (across >= 0) & (across < 1) & (down >= 0) & (down < 1)
    before, across, down, depth = before[on_screen], across[on_screen], down[on_screen], seen[on_screen, 2]
    mask = np.zeros(len(xyz), np.bool_)
    if not depth.size:
        return mask
    columns, rows = _cells(float(np.median(depth)), lens, disc)
    nearest, span = _nearest((down * rows).astype(np.intp), (across * columns).astype(np.intp), depth, (rows, columns))
    footprint = 2 * depth * max(lens.tangent_across / columns, lens.tangent_down / rows)
    unhidden = depth <= nearest + np.maximum(disc, _SLANT * footprint) + _REACH * span
    inside = (across >= part.left) & (across <= part.right) & (down >= part.top) & (down <= part.bottom)
    mask[before[unhidden & inside]] = True
    return mask


def _cells(depth: float, lens: Lens, disc: float) -> tuple[int, int]:
    """Columns and rows of cells that appear as wide as a disc at this depth."""
    columns, rows = (2 * depth * tangent / disc for tangent in (lens.tangent_across, lens.tangent_down))
    shrink = min(1.0, _FINEST / max(columns, rows))
    return max(1, int(columns * shrink)), max(1, int(rows * shrink))


def _nearest(
    row: NDArray[np.intp], column: NDArray[np.intp], depth: NDArray[np.float64], shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N,) for each point the least depth in its cell and the eight around it, and how much that changes in a cell."""
    buffer = np.full((shape[0] + 2, shape[1] + 2), np.inf)
    np.minimum.at(buffer, (row + 1, column + 1), depth)
    wide = np.minimum(np.minimum(buffer[:, :-2], buffer[:, 1:-1]), buffer[:, 2:])
    nearest = np.minimum(np.minimum(wide[:-2], wide[1:-1]), wide[2:])
    span = _slope(nearest, 0) + _slope(nearest, 1)
    return nearest[row, column], span[row, column]


def _slope(nearest: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """The smaller change to both neighbours; none beside empty cells."""
    filled = np.where(np.isfinite(nearest), nearest, np.nan)
    step = np.abs(np.diff(filled, axis=axis))
    edge = np.zeros_like(np.take(step, [0], axis=axis)) if step.size else np.zeros_like(filled)
    if not step.size:
        return edge
    before, after = np.concatenate([edge, step], axis=axis), np.concatenate([step, edge], axis=axis)
    return np.asarray(np.nan_to_num(np.minimum(before, after)))
