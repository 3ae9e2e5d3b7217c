"""What can be drawn over a cloud. All places are in the frame of the points; all lengths are metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from zsight_core.model import Shape

__all__ = ["Drawing", "Legend", "Outline", "Triad"]

Colour = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Outline:
    """The edges of a shape at a place; hidden edges are faint, visible faces tinted.

    Attributes:
        shape: box, cylinder, sphere or mesh.
        T_points_model: (4, 4).
        colour: red, green, blue.
        label: text above it; left out: none.
        dashed: draw visible edges dashed and tint nothing, as for a true pose beside a found one.
    """

    shape: Shape
    T_points_model: NDArray[np.float64]
    colour: Colour = (255, 200, 40)
    label: str | None = None
    dashed: bool = False


@dataclass(frozen=True, eq=False)
class Triad:
    """A frame as three arrows: x red, y green, z blue."""

    T_points_frame: NDArray[np.float64]
    length: float = 0.1
    label: str | None = None


@dataclass(frozen=True)
class Legend:
    """Lines of text in the lower left corner; a tab in a line parts two columns."""

    lines: tuple[str, ...]
    title: str | None = None


Drawing = Outline | Triad | Legend
