"""What stands where: bodies in a world and a camera that looks at them.

The world frame has z up and the ground at z = 0; lengths are metres. A camera's frame is optical: z forward, x right,
y down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import GeometryError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.model import ObjectModel
    from zsight_core.pinhole import Pinhole

__all__ = ["Body", "Camera", "World"]


@dataclass(frozen=True, eq=False)
class Body:
    """One object at one place; a Surface stands for the unbounded plane z = 0 of its model frame.

    ``reflects`` is the share of rays that come back to a noisy sensor: near 0 for glass. An ideal sensor sees it all.
    """

    name: str
    model: ObjectModel
    T_world_model: NDArray[np.float64]
    reflects: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.reflects <= 1:
            raise GeometryError(f"{self.name} reflects {self.reflects}; expected a share from 0 to 1")
        _require_rigid(f"T_world_model of {self.name}", self.T_world_model)


@dataclass(frozen=True, eq=False)
class World:
    """All bodies there are; they may touch."""

    bodies: tuple[Body, ...]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera without lens distortion; T_world_camera (4, 4) float64 places its optical frame."""

    pinhole: Pinhole
    T_world_camera: NDArray[np.float64]

    def __post_init__(self) -> None:
        _require_rigid("T_world_camera", self.T_world_camera)
        if self.pinhole.distortion is not None:
            raise GeometryError("the pinhole has lens distortion; a simulated camera has none: leave it out")


def _require_rigid(what: str, T: NDArray[np.float64]) -> None:
    rigid = T.shape == (4, 4) and bool(np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6))
    if not rigid or not np.isfinite(T).all() or np.linalg.det(T[:3, :3]) < 0:
        raise GeometryError(f"{what} is no rigid transform; expected a 4 x 4 matrix of a rotation and a translation")
