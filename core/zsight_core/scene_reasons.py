"""Why each point of a cloud is of a thing, or why it is not: what the scene stage made of it."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.points import xyz
from zsight_core.scene import TOO_LARGE, TOO_SMALL
from zsight_core.segments import NO_DATA, OBJECT, SURFACE
from zsight_core.transform import inverse, transform_xyz

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.scene import Scene
    from zsight_core.support import Support

__all__ = ["Reason", "reasons"]


class Reason(IntEnum):
    """What became of a point."""

    NO_DEPTH = 0
    """Nothing was measured there."""
    SURFACE = 1
    """It is of a surface that things stand on."""
    THING = 2
    """It is of a segment."""
    TOO_SMALL = 3
    """It is of a thing with fewer pixels than the limit, or of a speck."""
    TOO_LARGE = 4
    """It is of a thing that is longer than the limit."""
    RIPPLE = 5
    """It stands out so little, and so few do, that it is of the surface."""
    TOO_HIGH = 6
    """It is over a surface, and higher than the limit."""
    BELOW = 7
    """It is within the outline of a surface, and below it."""
    BESIDE = 8
    """It is beyond the outlines of all surfaces and their margin."""


def reasons(points: Points, scene: Scene) -> NDArray[np.uint8]:
    """The reason (H, W) of each point of a cloud.

    Args:
        points: (H, W), the cloud that the scene was made of, metres.
        scene: what was made of it.
    """
    found = _of_pixels(scene)
    if scene.view.pixel is not None:
        found = np.where(scene.view.pixel >= 0, found.reshape(-1)[scene.view.pixel], np.uint8(Reason.NO_DEPTH))
    found = found.reshape(points.shape)
    elsewhere = found == Reason.BESIDE
    found[elsewhere] = _off_surface(xyz(points)[elsewhere].astype(np.float64), scene)
    return found


def _of_pixels(scene: Scene) -> NDArray[np.uint8]:
    """Reasons (H, W) of the pixels of the view; all that are of no surface and no thing are BESIDE."""
    found = np.full(scene.kind.shape, Reason.BESIDE, np.uint8)
    found[scene.kind == NO_DATA] = Reason.NO_DEPTH
    found[scene.kind == SURFACE] = Reason.SURFACE
    raised = scene.kind == OBJECT
    found[raised] = _of_patches(scene)[raised]
    found[raised & (scene.pixel_labels == 1)] = Reason.RIPPLE
    found[scene.pixel_labels > 1] = Reason.THING
    return found


def _of_patches(scene: Scene) -> NDArray[np.uint8]:
    """Why the pixels (H, W) around the patches that are of no thing were dropped; specks are of no patch."""
    table = np.full(len(scene.fate) + 1, Reason.TOO_SMALL, np.uint8)
    table[:-1][scene.fate == TOO_LARGE] = Reason.TOO_LARGE
    table[:-1][scene.fate == TOO_SMALL] = Reason.TOO_SMALL
    cells = table[np.where(scene.patches.label < 0, len(scene.fate), scene.patches.label)]
    padded = np.pad(cells, 1, mode="edge")  # pixels at a rim take the word of a patch beside them
    rows, columns = cells.shape
    widest = np.max([padded[r : r + rows, c : c + columns] for r in range(3) for c in range(3)], axis=0)
    height, width = scene.kind.shape
    step = scene.patches.step
    whole: NDArray[np.uint8] = np.repeat(np.repeat(widest, step, axis=0), step, axis=1)[:height, :width]
    return whole


def _off_surface(points: NDArray[np.float64], scene: Scene) -> NDArray[np.uint8]:
    """Reasons (N,) of points (N, 3) that are neither of a surface nor stand on one."""
    found = np.full(len(points), Reason.BESIDE, np.uint8)
    for support in scene.supports:
        standing = transform_xyz(inverse(support.T_camera_support), points)
        over = _within(standing[:, :2], support, scene.limits.margin)
        found[over & (standing[:, 2] < 0) & (found == Reason.BESIDE)] = Reason.BELOW
        found[over & (standing[:, 2] > scene.limits.highest)] = Reason.TOO_HIGH
    return found


def _within(points: NDArray[np.floating], support: Support, margin: float) -> NDArray[np.bool_]:
    """Mask (N,) of the points (N, 2) within the outline of a surface or its margin."""
    inside = np.ones(len(points), np.bool_)
    for corner, following in zip(support.outline, np.roll(support.outline, -1, axis=0), strict=True):
        along = following - corner
        left = along[0] * (points[:, 1] - corner[1]) - along[1] * (points[:, 0] - corner[0])
        inside &= left >= -margin * np.hypot(*along)
    return inside
