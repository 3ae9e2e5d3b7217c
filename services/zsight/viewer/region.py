"""A region of interest: where finds look, as a box that is drawn in the scene."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.viewer.box_lines import corners_of, edges_of
from zsight.viewer.frames import place
from zsight_protocol.geometry import Region

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import viser
    from numpy.typing import NDArray

    from zsight.viewer.frames import Frames

__all__ = ["RegionOfInterest", "feet", "region_around"]

_BLUE = (0, 114, 178)
_SUNK = 0.02  # metres that most of a thing's points may lie below the surface it stands on
_BESIDE = 0.03  # metres that it may hang over the outline


def region_around(points: NDArray[Any], around: float, above: float = 0.0) -> Region:
    """The upright box around points (N, 3), metres, wider by so much on every side, and higher by so much on top."""
    x0, y0, z0 = (float(value) for value in points.min(axis=0) - around)
    x1, y1, z1 = (float(value) for value in points.max(axis=0) + around)
    return Region(low=(x0, y0, z0), high=(x1, y1, z1 + above))


def feet(points: NDArray[Any], surfaces: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> NDArray[Any]:
    """The points (N, 3) dropped onto the nearest surface below them; none (0, 3) where they stand over no surface.

    Args:
        points: of one thing, metres.
        surfaces: of each, T_points_surface (4, 4) with z up from it, and its convex outline (K, 2) in that frame,
            counter-clockwise.
    """
    best, nearest = points[:0], np.inf
    for T, outline in surfaces:
        standing = (points - T[:3, 3]) @ T[:3, :3]
        height = float(np.median(standing[:, 2]))
        if -_SUNK <= height < nearest and _is_over(np.median(standing[:, :2], axis=0), outline):
            standing[:, 2] = 0.0
            best, nearest = standing @ T[:3, :3].T + T[:3, 3], height
    return best


def _is_over(point: NDArray[Any], outline: NDArray[np.float64]) -> bool:
    """True for a point (2,) within a convex outline or a little beside it."""
    along = np.roll(outline, -1, axis=0) - outline
    to = point - outline
    inward = (along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0]) / np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    return len(outline) > 2 and bool((inward > -_BESIDE).all())


class RegionOfInterest:
    """Where finds look; everywhere to begin with."""

    def __init__(self, server: viser.ViserServer, frames: Frames) -> None:
        """Args: server of the page; frames that place the box."""
        self.on_change: Callable[[str], None] = lambda _: None
        self._server, self._frames = server, frames
        self._chosen: tuple[Region, str] | None = None
        self._generation = frames.generation
        self._lock = threading.RLock()

    @property
    def chosen(self) -> tuple[Region, str] | None:
        """The box, and the frame that it stands upright in."""
        return self._chosen

    def choose(self, region: Region, what: str) -> None:
        """Look only there from now on: a box of the fixed frame, and what it is in words."""
        self._chosen = region, self._frames.fixed
        self._draw()
        x, y, z = np.subtract(region.high, region.low)
        self.on_change(f"**Finds look only in {what}**: {x:.3f} x {y:.3f} x {z:.3f} m in {self._frames.fixed}.")

    def clear(self) -> None:
        """Look everywhere again."""
        self._chosen = None
        self._draw()
        self.on_change("")

    def update(self) -> None:
        """Draw anew where the fixed frame has changed."""
        if self._generation != self._frames.generation:
            self._generation = self._frames.generation
            self._draw()

    def _draw(self) -> None:
        with self._lock:
            T = None if self._chosen is None else self._frames.T_fixed(self._chosen[1])
            if self._chosen is None or T is None:
                self._server.scene.remove_by_name("/region")
                return
            low, high = np.array(self._chosen[0].low), np.array(self._chosen[0].high)
            edges = edges_of(corners_of(low, high))
            self._server.scene.add_line_segments(
                "/region", edges, _BLUE, thickness=3.0, thickness_units="screen", **place(T)
            )
