"""A region of interest: the box around something, in the fixed frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from zsight_protocol.geometry import Region

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["region_around"]


def region_around(points: NDArray[Any], around: float, above: float = 0.0) -> Region:
    """The upright box around points (N, 3), metres, wider by so much on every side, and higher by so much on top."""
    x0, y0, z0 = (float(value) for value in points.min(axis=0) - around)
    x1, y1, z1 = (float(value) for value in points.max(axis=0) + around)
    return Region(low=(x0, y0, z0), high=(x1, y1, z1 + above))
