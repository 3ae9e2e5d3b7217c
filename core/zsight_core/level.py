"""A camera's place from the level surface it sees, and the mistake of taking one kind of camera frame for the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import GeometryError
from zsight_core.transform import from_quaternion, from_rpy, inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["T_BODY_OPTICAL", "frame_mistake", "level_camera"]

T_BODY_OPTICAL = from_quaternion((0, 0, 0), (-0.5, 0.5, -0.5, 0.5))
"""An optical frame (z forward, x right, y down) in its body frame (x forward, y left, z up), as REP-103 has them."""

_LEVEL = np.radians(15)  # a surface within this of horizontal is a table or a floor
_TILTED = np.radians(30)  # beyond this it is neither, or the camera's frame is not what it is taken for


def level_camera(
    normal: NDArray[np.float64],
    distance: float,
    surface_height: float = 0.0,
    T_world_camera: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Where a camera is above a level surface that it sees.

    Args:
        normal: (3,) unit normal of the surface, up, in the camera's optical frame.
        distance: n . p of its points, metres, negative.
        surface_height: of the surface in the world, metres.
        T_world_camera: (4, 4) where the camera was taken to be; None: nothing is known.

    Returns:
        T_world_camera (4, 4): roll, pitch and height are those that make the surface level. A plane tells neither place
        nor yaw: they stay what they were, and where nothing was known the camera stands above the world's origin and
        looks along its x axis.

    Raises:
        GeometryError: the camera looks straight along the normal, so that no direction is forward.
    """
    forward = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    length = float(np.linalg.norm(forward))
    if length < 1e-6:
        raise GeometryError("the camera looks straight down at the surface: no direction is forward; tilt it a little")
    x_world = forward / length
    T = np.eye(4)
    T[:3, :3] = [x_world, np.cross(normal, x_world), normal]
    T[2, 3] = surface_height - distance
    return T if T_world_camera is None else _heading_as(T_world_camera) @ T


def _heading_as(T_world_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """The turn about the world's z (4, 4), and the shift along its x and y, from its origin to the camera."""
    x, y = T_world_camera[:2, 2]  # where the optical axis points
    place = (float(T_world_camera[0, 3]), float(T_world_camera[1, 3]), 0.0)
    return from_rpy(place, (0.0, 0.0, float(np.arctan2(y, x))))


def frame_mistake(normal: NDArray[np.float64], T_world_camera: NDArray[np.float64]) -> str:
    """What is wrong with a camera's frame, in words, or nothing where its support surface is level.

    Args:
        normal: (3,) unit normal, towards the camera, of the surface that objects stand on, in the cloud's frame, found
            without using the camera's pose.
        T_world_camera: (4, 4) pose of the cloud's frame in a world with z up.
    """
    tilt = _tilt(normal, T_world_camera)
    if tilt < _TILTED:
        return ""
    degrees = f"the support surface is {np.degrees(tilt):.0f} degrees off level"
    if _tilt(normal, T_world_camera @ T_BODY_OPTICAL) < _LEVEL:
        return (
            f"{degrees}: the cloud is in an optical frame (z forward), but its transform is that of a body frame "
            "(x forward); add the rotation -0.5 0.5 -0.5 0.5 behind it"
        )
    if _tilt(normal, T_world_camera @ inverse(T_BODY_OPTICAL)) < _LEVEL:
        return (
            f"{degrees}: the cloud is in a body frame (x forward), but its transform is that of an optical frame "
            "(z forward); add the rotation 0.5 -0.5 0.5 0.5 behind it"
        )
    return f"{degrees}: is the camera's pose right? It can be measured with: zsight calibrate level"


def _tilt(normal: NDArray[np.float64], T_world_camera: NDArray[np.float64]) -> float:
    """Angle between a normal and the world's up, radians."""
    return float(np.arccos(np.clip(T_world_camera[2, :3] @ normal, -1, 1)))
