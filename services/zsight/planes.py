"""The planes service: the plane of a patch that a person selected, and the points of the cloud that lie in it.

After the chapter's find_plane_pcd_file: a patch comes in on ``selected_points``; out go the plane, all points of the
newest cloud within a tolerance of it, and, if asked for, the points that stand above it.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from zsight.convert import cloud_from_points, points_of, pose_of, vector
from zsight.settings import Live
from zsight.settings import Settings as ServiceSettings
from zsight_core import above_plane, connected, filters, plane, statistics, take
from zsight_core.errors import CoreError
from zsight_protocol.geometry import Plane
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight.bus import Bus, Writer
    from zsight_core.points import Points

__all__ = ["PatchPlane", "Settings", "plane_of_patch", "run"]

log = logging.getLogger(__name__)

_WIDENINGS = 4  # the plane of a warped carpet stays within 0.1 degrees from then on
_CLOUD_WAIT = 2.0  # seconds that a patch waits for the first cloud
_FRESH_WAIT = 0.1  # seconds that it waits for a newer one than the last, which may be held up on the way


class Settings(ServiceSettings):
    """Settings of the planes service."""

    camera: str = Field("kinect", description="camera whose clouds and patches are read")
    tolerance: Live[float] = Field(
        0.01, gt=0, le=1, description="how near a point of the plane lies, metres (above 0, up to 1)"
    )
    connected: Live[bool] = Field(False, description="only points connected to the patch")
    gap: Live[float] = Field(
        0.03, gt=0, le=1, description="longest step between connected points, metres (above 0, up to 1)"
    )
    above: Live[bool] = Field(False, description="publish the points that stand above the plane as well")
    above_low: Live[float] = Field(0.015, ge=0, le=10, description="least height of those, metres (0 to 10)")
    above_high: Live[float] = Field(0.5, ge=0, le=10, description="greatest height of those, metres (0 to 10)")


@dataclass(frozen=True)
class PatchPlane:
    """The plane of a patch: its fit, which points of the cloud (H, W) lie in it, and a frame on it (4, 4)."""

    fit: plane.PlaneFit
    members: NDArray[np.bool_]
    T_camera_plane: NDArray[np.float64]


def run(bus: Bus, settings: Settings) -> None:
    """Answer every patch with its plane."""
    for module in (above_plane, connected, filters, plane, statistics, take):
        module.warm_up()
    clouds = bus.reader(bus.cell.points(settings.camera), PointCloud2)
    patches = bus.reader(bus.cell.selected_points(settings.camera), PointCloud2)
    planes = bus.writer(bus.cell.plane(settings.camera), Plane)
    inside = bus.writer(bus.cell.plane_points(settings.camera), PointCloud2)
    above = bus.writer(bus.cell.points_above_plane(settings.camera), PointCloud2)
    bus.ready()
    cloud: PointCloud2 | None = None
    for patch in patches:
        now = settings.model_copy()  # one patch is treated alike throughout
        newest = clouds.take(_FRESH_WAIT if cloud is not None else _CLOUD_WAIT)
        cloud = newest.message if newest is not None else cloud
        if cloud is None:
            log.warning("a patch came, but no cloud on %s: is the camera running?", clouds.counter.key)
            continue
        if patch.header.frame_id != cloud.header.frame_id:
            log.warning("patch is in frame %s, the cloud in %s", patch.header.frame_id, cloud.header.frame_id)
            continue
        try:
            found = plane_of_patch(points_of(cloud), points_of(patch), now)
        except CoreError as error:
            log.warning("no plane of this patch: %s", error)
            continue
        planes.send(plane_message(found, cloud, now.tolerance))
        _send_points(inside, cloud, found.members)
        if now.above:
            low, high = now.above_low, now.above_high
            standing = above_plane.points_above(points_of(cloud), found.fit.plane, low, high, found.members)
            if standing.size:
                above.send(cloud_from_points(standing, cloud.header.stamp, cloud.header.frame_id))


def plane_of_patch(points: Points, patch: Points, settings: Settings) -> PatchPlane:
    """The plane of a patch, and the points of a cloud that lie in it.

    A robust plane of the patch alone comes first; then the plane follows what the cloud shows of the same surface.

    Args:
        points: (H, W) the whole cloud, metres, camera frame.
        patch: (1, M) the selected points, same frame.
        settings: tolerance, and whether only what is connected to the patch counts.

    Raises:
        GeometryError: the patch has fewer than 3 points, or no plane.
    """
    fit = _widened(points, patch, plane.fit_robust(patch, settings.tolerance), settings.tolerance)
    members = plane.inliers(points, fit.plane, settings.tolerance)
    if settings.connected:
        members = connected.connected_to(points, members, members & _near(points, patch), settings.gap)
    on_plane = take.take(patch, plane.inliers(patch, fit.plane, settings.tolerance))
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


def plane_message(found: PatchPlane, cloud: PointCloud2, tolerance: float) -> Plane:
    """What is published of a plane."""
    return Plane(
        header=cloud.header,
        normal=vector(found.fit.plane.normal),
        distance=float(found.fit.plane.distance),
        pose=pose_of(found.T_camera_plane),
        inliers=int(np.count_nonzero(found.members)),
        tolerance=tolerance,
        rms=float(found.fit.rms),
    )


def _send_points(writer: Writer[PointCloud2], cloud: PointCloud2, members: NDArray[np.bool_]) -> None:
    chosen = take.take(points_of(cloud), members)
    if chosen.size:
        writer.send(cloud_from_points(chosen, cloud.header.stamp, cloud.header.frame_id))
