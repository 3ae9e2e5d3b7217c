"""Level tops of what stands in a scene: height layers, on which something else may stand."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.scene import Scene

__all__ = ["LevelTop", "level_tops"]

LEVEL = float(np.cos(np.radians(14.0)))
"""Upward part of a patch's mean normal from which it is level."""

FLAT = 0.004
"""Metres, besides four standard deviations of depth, between the heights of its lowest and highest twentieth."""

SMALLEST = 20
"""Cells of a patch that is large enough to stand on."""


class LevelTop(NamedTuple):
    """A smooth, level piece of a segment."""

    segment: int
    """Its label."""
    height: float
    """Metres over the support surface."""
    xy: NDArray[np.float64]
    """(N, 2) metres in the support's frame."""


def level_tops(scene: Scene) -> list[LevelTop]:
    """All of a scene, the lowest of each segment first."""
    cells, step = scene.cells, scene.patches.step
    found: list[LevelTop] = []
    for k, segment in enumerate(scene.owner):
        members = slice(int(cells.start[k]), int(cells.start[k + 1]))
        if segment < 2 or members.stop - members.start < SMALLEST:
            continue
        normal, points = cells.normals[members].sum(axis=0), cells.points[members]
        low, height, high = np.quantile(points[:, 2], [0.05, 0.5, 0.95])
        depth = scene.view.depth[cells.row[members.start] * step, cells.column[members.start] * step]
        is_flat = high - low < FLAT + 4 * scene.noise * float(depth) ** 2
        if is_flat and normal[2] > LEVEL * np.linalg.norm(normal):
            found.append(LevelTop(int(segment), float(height), points[:, :2]))
    return sorted(found, key=lambda top: (top.segment, top.height))
