"""What the colours of a cloud's points say."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.colour_map import graded, spread
from zsight_core.points import Points, colours, has_colour

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Colouring", "coloured"]

_INTENSITY = ("intensity", "intensities", "i", "reflectivity")  # names that drivers give the field
_OLD = 2.0  # seconds; a cloud of this age is as dark as can be


class Colouring(StrEnum):
    """What the colour stands for."""

    RGB = "rgb"
    HEIGHT = "height"
    INTENSITY = "intensity"
    AGE = "age"


def coloured(
    points: Points, heights: NDArray[np.floating], age: float, wish: Colouring
) -> tuple[NDArray[np.uint8], Colouring]:
    """Colours (M, 3) of points, and what they stand for: heights where the cloud has not what is wished.

    Args:
        points: (M,) without holes.
        heights: (M,) metres, in the fixed frame.
        age: of the cloud, seconds.
        wish: what the colours are to say.
    """
    if wish is Colouring.RGB and has_colour(points):
        return colours(points), wish
    if wish is Colouring.AGE:
        return graded(np.full(len(points), -age), -_OLD, 0.0), wish
    names = points.dtype.names or ()
    intensity = next((name for name in _INTENSITY if name in names), None)
    if wish is Colouring.INTENSITY and intensity is not None:
        values = points[intensity].astype(np.float64)
        return graded(values, *spread(values)), wish
    return graded(heights, *spread(heights)), Colouring.HEIGHT
