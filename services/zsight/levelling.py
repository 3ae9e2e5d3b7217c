"""A running camera, levelled by the table or floor that it sees."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import points_of
from zsight.errors import DeadlinePassed, NobodyAnswers, UsageError, ZsightError
from zsight.hosts.beats import ask_health
from zsight.transforms import TransformBuffer
from zsight_core.transform import quaternion
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from zsight.bus import Bus
    from zsight_core.points import Points

__all__ = ["CameraLevel", "await_level", "level_of", "measure_level", "process_of"]

_ROUNDED = 1e-5  # the setting has six decimals
_HIGHEST = 100.0  # metres that a surface may be from the world's origin, up or down
_PATIENCE = 0.5  # seconds in which static transforms come, which late joiners get at once


@dataclass(frozen=True, eq=False)
class CameraLevel:
    """Where a camera is above the level surface that it sees."""

    T_world_camera: NDArray[np.float64]
    """(4, 4) pose of the clouds' frame; place and yaw as they were known before, else zero."""
    area: float
    """Of the surface, square metres."""
    rms: float
    """Of the surface's points about their plane, metres."""
    frame_id: str = ""
    """Of the clouds; empty where the cloud came from a file."""

    @property
    def height(self) -> float:
        """Of the camera in the world, metres."""
        return float(self.T_world_camera[2, 3])

    @property
    def roll(self) -> float:
        """About the optical axis, radians; positive where the image's right side is low."""
        return float(np.arctan2(-self.T_world_camera[2, 0], -self.T_world_camera[2, 1]))

    @property
    def pitch(self) -> float:
        """Downward, radians."""
        return float(np.arcsin(np.clip(-self.T_world_camera[2, 2], -1, 1)))

    @property
    def pose(self) -> tuple[float, ...]:
        """X y z in metres and the quaternion x y z w."""
        return (*(float(v) for v in self.T_world_camera[:3, 3]), *(float(v) for v in quaternion(self.T_world_camera)))

    @property
    def setting(self) -> str:
        """The same as the camera service's setting ``pose``."""
        return " ".join(f"{value:.6f}" for value in self.pose)


def level_of(points: Points, surface_height: float, T_world_camera: NDArray[np.float64] | None = None) -> CameraLevel:
    """Where the camera of a cloud is.

    Args:
        points: (H, W) or (1, N) cloud in an optical frame, metres.
        surface_height: of the largest surface in view, metres in the world.
        T_world_camera: (4, 4) where the camera was taken to be; None: nothing is known.

    Raises:
        UsageError: the height is none of a surface.
        ZsightError: no surface is in view.
        GeometryError: the camera looks straight down at it.
    """
    if not abs(surface_height) <= _HIGHEST:  # so that what is no number is none either
        raise UsageError(f"the surface is {surface_height} m high; expected {-_HIGHEST:g} to {_HIGHEST:g} m")
    from zsight_core.level import level_camera
    from zsight_core.scene import understand

    scene = understand(points)  # without the pose, which may be wrong
    if not scene.supports:
        raise ZsightError("no level surface is in view: point the camera at a table or the floor")
    surface = scene.supports[0]
    T = level_camera(surface.normal, surface.distance, surface_height, T_world_camera)
    return CameraLevel(T, surface.area, surface.rms)


def measure_level(bus: Bus, camera: str, surface_height: float, timeout: float) -> CameraLevel:
    """The same for the next cloud of a running camera, with the place and yaw that the cell knows.

    Raises:
        DeadlinePassed: no cloud came.
        ZsightError: no surface is in view.
    """
    key = bus.cell.points(camera)
    with contextlib.closing(bus.reader(key, PointCloud2)) as clouds:
        received = clouds.take(timeout)
    if received is None:
        raise DeadlinePassed(f"no cloud on {key} within {timeout:g} s: is the camera running? See: zsight node list")
    cloud = received.message
    known = next(_told_poses(bus, cloud.header.frame_id, _PATIENCE), None)
    return replace(level_of(points_of(cloud), surface_height, known), frame_id=cloud.header.frame_id)


def await_level(bus: Bus, level: CameraLevel, timeout: float) -> None:
    """Return when the camera has told everybody that it stands there.

    Raises:
        DeadlinePassed: it has not.
    """
    for T_world_camera in _told_poses(bus, level.frame_id, timeout):
        if np.allclose(T_world_camera, level.T_world_camera, atol=_ROUNDED):
            return
    raise DeadlinePassed(f"the camera did not tell its new pose within {timeout:g} s: see its log")


def _told_poses(bus: Bus, frame: str, timeout: float) -> Iterator[NDArray[np.float64]]:
    """T_world_camera (4, 4) after each news of static transforms, until none came for timeout seconds."""
    buffer = TransformBuffer()
    with contextlib.closing(bus.reader(bus.cell.tf_static, TransformList)) as transforms:
        while (received := transforms.take(timeout)) is not None:
            buffer.put(received.message, static=True)
            root = buffer.root_of(frame)
            if root != frame:
                yield buffer.lookup(root, frame)


def process_of(bus: Bus, camera: str) -> str:
    """HOST/NAME of the process that publishes a camera's clouds.

    Raises:
        NobodyAnswers: there is none.
    """
    key = bus.cell.points(camera)
    for beat in ask_health(bus):
        if any(writer.key == key for writer in beat.writers):
            return f"{beat.host}/{beat.process}"
    raise NobodyAnswers(f"no process writes {key}: is the camera running? See: zsight node list")
