"""The voxel service: every cloud of a camera, down-sampled."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from pydantic import Field

from zsight.convert import cloud_from_points, points_of
from zsight.settings import Live
from zsight.settings import Settings as ServiceSettings
from zsight_core import voxel_grid
from zsight_core.errors import CoreError
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from zsight.bus import Bus

__all__ = ["Settings", "downsample", "run"]

log = logging.getLogger(__name__)


class Settings(ServiceSettings):
    """Settings of the voxel service."""

    camera: str = Field("kinect", description="camera whose clouds are read")
    leaf: Live[float] = Field(0.02, gt=0, le=10, description="edge of a voxel, metres (above 0, up to 10)")


def run(bus: Bus, settings: Settings) -> None:
    """Read clouds, write smaller ones with the stamp and frame they came with."""
    voxel_grid.warm_up()
    clouds = bus.reader(bus.cell.points(settings.camera), PointCloud2)
    writer = bus.writer(bus.cell.voxel_points(settings.camera), PointCloud2)
    bus.ready()

    def smaller_one(cloud: PointCloud2) -> PointCloud2 | None:
        return downsample(cloud, settings.leaf)

    # map lets go of a cloud before the next one is copied, into the same memory, which is in the cache then.
    for smaller in map(smaller_one, clouds):
        if smaller is not None:
            writer.send(smaller)


def downsample(cloud: PointCloud2, leaf: float) -> PointCloud2 | None:
    """The cloud with one averaged point a voxel; none where it has no point that can be averaged, which is logged."""
    try:
        averaged = voxel_grid.voxel_grid(points_of(cloud), leaf)
    except CoreError as error:
        log.warning("cloud of %s at %d ns left out: %s", cloud.header.frame_id, cloud.header.stamp.ns, error)
        return None
    except Exception:
        log.exception("cloud of %s at %d ns left out", cloud.header.frame_id, cloud.header.stamp.ns)
        return None
    if averaged.size == 0:
        log.warning("cloud of %s at %d ns left out: no finite point", cloud.header.frame_id, cloud.header.stamp.ns)
        return None
    return cloud_from_points(averaged, cloud.header.stamp, cloud.header.frame_id, is_dense=True)
