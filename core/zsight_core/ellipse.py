"""The computed cloud of the book's chapter on point clouds: an ellipse extruded along z and graded in colour."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight_core.points import from_xyz

if TYPE_CHECKING:
    from zsight_core.points import Points

__all__ = ["ellipse"]

_LAYERS = 40
_ANGLES = 73  # every 5 degrees; 0 and 360 are both there, as in the book's cloud


def ellipse() -> Points:
    """The ellipse x = 0.5 cos a, y = sin a, repeated in 40 layers from z = -1.00 to 0.95 in steps of 0.05 m.

    The colour runs with z from red over green (z = 0) to blue.

    Returns:
        Points (1, 2920) of dtype XYZRGB, metres; layer by layer from below, angles rising within a layer.
    """
    layers = np.arange(_LAYERS) / 20 - 1
    angles = np.radians(np.linspace(0, 360, _ANGLES))
    z, angle = np.meshgrid(layers, angles, indexing="ij")
    xyz = np.stack([0.5 * np.cos(angle), np.sin(angle), z], axis=-1)
    return from_xyz(xyz.reshape(1, -1, 3), _colour(z).reshape(1, -1, 3))


def _colour(z: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Red at z = -1, green at 0, blue at 1, mixed linearly between."""
    stops = {"red": (255, 0, 0), "green": (0, 255, 0), "blue": (0, 0, 255)}
    channels = [np.interp(z, (-1, 0, 1), stops[name]) for name in stops]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)
