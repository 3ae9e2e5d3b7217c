"""What there is to know of an object type in order to recognise, simulate or draw it.

The model frame has its origin at the centre of the shape's bounding box and z along a cylinder's axis; a pose
``T_frame_model`` places that frame. Lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.errors import ModelError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Box", "Cylinder", "Mesh", "ObjectModel", "Shape", "Sphere", "Surface", "size_of"]


@dataclass(frozen=True)
class Box:
    """A cuboid with its edges along x, y and z."""

    size: tuple[float, float, float]

    def __post_init__(self) -> None:
        _require_positive("box size", self.size)


@dataclass(frozen=True)
class Cylinder:
    """A circular cylinder about z."""

    diameter: float
    height: float

    def __post_init__(self) -> None:
        _require_positive("cylinder diameter and height", (self.diameter, self.height))


@dataclass(frozen=True)
class Sphere:
    """A ball."""

    diameter: float

    def __post_init__(self) -> None:
        _require_positive("sphere diameter", (self.diameter,))


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: vertices (V, 3) float64, metres; faces (F, 3) int32, counter-clockwise seen from outside."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]

    def __post_init__(self) -> None:
        if self.vertices.ndim != 2 or self.vertices.shape[1:] != (3,) or not np.isfinite(self.vertices).all():
            raise ModelError(f"mesh vertices have shape {self.vertices.shape}; expected (V, 3), all finite")
        if self.faces.ndim != 2 or self.faces.shape[1:] != (3,) or len(self.faces) == 0:
            raise ModelError(f"mesh faces have shape {self.faces.shape}; expected (F, 3) with at least one face")
        if self.faces.min() < 0 or self.faces.max() >= len(self.vertices):
            raise ModelError(f"mesh faces point at vertex {self.faces.max()} of {len(self.vertices)}")


@dataclass(frozen=True)
class Surface:
    """A support surface such as a table top: flat, near horizontal, at least this large in square metres."""

    minimum_area: float = 0.05


Shape = Box | Cylinder | Sphere | Mesh | Surface


@dataclass(frozen=True)
class ObjectModel:
    """An object type: its name, its shape and, where known, its colour (red, green, blue in 0..255)."""

    name: str
    shape: Shape
    colour: tuple[int, int, int] | None = None


def size_of(shape: Shape) -> tuple[float, float, float]:
    """Edge lengths x, y, z of the shape's bounding box in the model frame, metres; zeros for a surface."""
    match shape:
        case Box(size):
            return size
        case Cylinder(diameter, height):
            return (diameter, diameter, height)
        case Sphere(diameter):
            return (diameter, diameter, diameter)
        case Mesh(vertices, _):
            x, y, z = np.ptp(vertices, axis=0)
            return (float(x), float(y), float(z))
        case Surface():
            return (0.0, 0.0, 0.0)


def _require_positive(what: str, lengths: tuple[float, ...]) -> None:
    if not all(np.isfinite(length) and length > 0 for length in lengths):
        raise ModelError(f"{what} is {lengths} m; expected lengths above zero")
