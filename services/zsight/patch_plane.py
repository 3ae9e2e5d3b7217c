"""The plane of a patch of a cloud, and the points of the cloud that lie in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core import connected, filters, plane, statistics, take

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["PatchPlane", "plane_of_patch"]

_WIDENINGS = 4  # the plane of a warped carpet stays within 0.1 degrees from then on


@dataclass(frozen=True)
class PatchPlane:
    """The plane of a patch: its fit, which points of the cloud (H, W) lie in it, and a frame on it (4, 4)."""

    fit: plane.PlaneFit
    members: NDArray[np.bool_]
    T_camera_plane: NDArray[np.float64]


def plane_of_patch(
    points: Points, patch: Points, *, tolerance: float = 0.01, connected_only: bool = False, gap: float = 0.03
) -> PatchPlane:
    """The plane of a patch, and the points of a cloud that lie in it.

    A robust plane of the patch alone comes first; then the plane follows what the cloud shows of the same surface.

    Args:
        points: (H, W) the whole cloud, metres, camera frame.
        patch: (1, M) the selected points, same frame.
        tolerance: how near a point of the plane lies, metres.
        connected_only: whether only what is connected to the patch counts.
        gap: longest step between connected points, metres.

    Raises:
        GeometryError: the patch has fewer than 3 points, or no plane.
    """
    fit = _widened(points, patch, plane.fit_robust(patch, tolerance), tolerance)
    members = plane.inliers(points, fit.plane, tolerance)
    if connected_only:
        members = connected.connected_to(points, members, members & _near(points, patch), gap)
    on_plane = take.take(patch, plane.inliers(patch, fit.plane, tolerance))
    return PatchPlane(fit, members, plane.frame_on_plane(fit.plane, statistics.centroid(on_plane)))


def _widened(points: Points, patch: Points, fit: plane.PlaneFit, tolerance: float) -> plane.PlaneFit:
    """The same surface, fitted to all that the cloud shows of it: a depth camera warps a small patch by up to a degree.

    The points within half the tolerance are taken a few times, each time of the last plane. Where the patch itself then
    no longer lies in the plane (it is of a book on the table), its own plane is kept.
    """
    wide = fit
    for _ in range(_WIDENINGS):
        near = take.take(points, plane.inliers(points, wide.plane, tolerance / 2))
        if near.size < fit.inliers:
            return fit
        wide = plane.fit_robust(near, tolerance / 2)
    own = plane.inliers(patch, fit.plane, tolerance)
    moved = float(np.median(np.abs(plane.heights(patch, wide.plane)[own])))
    return wide if moved <= 3 * fit.rms else fit


def _near(points: Points, patch: Points) -> NDArray[np.bool_]:
    """The points of a cloud within the patch's bounding box."""
    low, high = statistics.bounding_box(patch)
    return filters.box_mask(points, low, high)
