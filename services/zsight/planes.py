"""The planes service: the plane of a patch that a person selected, and the points of the cloud that lie in it.

After the chapter's find_plane_pcd_file: a patch comes in on ``selected_points``; out go the plane, all points of the
newest cloud within a tolerance of it, and, if asked for, the points that stand above it.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from zsight.convert import cloud_from_points, points_of, pose_of, vector
from zsight.errors import ConnectionLost
from zsight.patch_plane import plane_of_patch
from zsight.settings import Live
from zsight.settings import Settings as ServiceSettings
from zsight_core import above_plane, connected, filters, plane, statistics, take
from zsight_core.errors import CoreError
from zsight_protocol.geometry import Plane
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from zsight.bus import Bus, Writer
    from zsight.patch_plane import PatchPlane
    from zsight_core.points import Points

__all__ = ["Settings", "run"]

log = logging.getLogger(__name__)

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
            points = points_of(cloud)
            found = plane_of_patch(
                points, points_of(patch), tolerance=now.tolerance, connected_only=now.connected, gap=now.gap
            )
            planes.send(plane_message(found, cloud, now.tolerance))
            _send_points(inside, cloud, take.take(points, found.members))
            if now.above:
                low, high = now.above_low, now.above_high
                standing = above_plane.points_above(points, found.fit.plane, low, high, found.members)
                _send_points(above, cloud, standing)
        except CoreError as error:
            log.warning("no plane of this patch, or not all of it: %s", error)
        except ConnectionLost:
            raise
        except Exception:
            log.exception("no plane of this patch, or not all of it")


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


def _send_points(writer: Writer[PointCloud2], cloud: PointCloud2, chosen: Points) -> None:
    """Some points of a cloud, where there are any."""
    if chosen.size:
        writer.send(cloud_from_points(chosen, cloud.header.stamp, cloud.header.frame_id))
