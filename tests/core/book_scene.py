"""The book's scene, for the tests of the finder: a cafe table seen by a Kinect from above, with what is put on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.model import Box, Cylinder, ObjectModel, Surface
from zsight_core.pinhole import Pinhole
from zsight_core.simulation.camera import Noise, capture
from zsight_core.simulation.world import Body, Camera, World
from zsight_core.transform import from_quaternion, from_rpy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

TABLE_HEIGHT = 0.7747
T_OPTICAL = from_quaternion((0, 0, 0), (-0.5, 0.5, -0.5, 0.5))
T_WORLD_CAMERA = from_rpy((0.027, 0, 1.810), (0, 1.2, 0)) @ T_OPTICAL

TOY_BLOCK = ObjectModel("toy_block", Box((0.035, 0.2, 0.035)), (200, 30, 30))
COKE_CAN = ObjectModel("coke_can", Cylinder(0.066, 0.122))
SLIM_CAN = ObjectModel("slim_can", Cylinder(0.053, 0.134))
TABLE = ObjectModel("table_surface", Surface())
T_WORLD_BLOCK = from_rpy((0.5, -0.35, 0.7922), (0, 0, 0.43))


def at(x: float, y: float, z: float, yaw: float = 0.0) -> NDArray[np.float64]:
    """T_world_model (4, 4) of something upright."""
    return from_rpy((x, y, z), (0, 0, yaw))


def cloud(
    *objects: tuple[ObjectModel, NDArray[np.float64]],
    noise: Noise | None = None,
    seed: int = 0,
    T_world_camera: NDArray[np.float64] = T_WORLD_CAMERA,
) -> Points:
    """What the camera sees of the table and the objects."""
    x, y = 0.756, -0.289
    furniture = [
        (ObjectModel("ground", Surface()), np.eye(4)),
        (ObjectModel("top", Box((0.9144, 0.9144, 0.04))), at(x, y, TABLE_HEIGHT - 0.02)),
        (ObjectModel("column", Box((0.042, 0.042, 0.73))), at(x, y, 0.365)),
        (ObjectModel("foot", Box((0.56, 0.56, 0.04))), at(x, y, 0.02)),
    ]
    bodies = tuple(Body(model.name, model, T) for model, T in [*furniture, *objects])
    camera = Camera(Pinhole(640, 480, 554.38, 554.38, 319.5, 239.5), T_world_camera)
    return capture(World(bodies), camera, noise, seed)
