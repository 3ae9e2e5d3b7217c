"""The cloud of this package: a numpy structured array of shape (height, width), one record a point.

The record mirrors PointCloud2: named fields at byte offsets, ``x y z`` in metres as float32, ``rgb`` packed as
0x00RRGGBB into the bits of a float32, padding allowed. A missing measurement is NaN. An unorganised cloud has height 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import PointsError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["XYZ", "XYZRGB", "Points", "colours", "from_xyz", "has_colour", "is_organised", "pack_rgb", "xyz"]

Points = np.ndarray[Any, np.dtype[np.void]]

XYZ = np.dtype({"names": ["x", "y", "z"], "formats": ["<f4"] * 3, "offsets": [0, 4, 8], "itemsize": 16})
XYZRGB = np.dtype({"names": ["x", "y", "z", "rgb"], "formats": ["<f4"] * 4, "offsets": [0, 4, 8, 12], "itemsize": 16})


def from_xyz(xyz: ArrayLike, rgb: ArrayLike | None = None) -> Points:
    """Make a cloud.

    Args:
        xyz: (N, 3) or (H, W, 3) coordinates, metres.
        rgb: the same leading shape x 3, uint8 red green blue; left out: a cloud without colour.

    Returns:
        Points of shape (1, N) or (H, W), dtype XYZ or XYZRGB.

    Raises:
        PointsError: the shapes are not those.
    """
    coordinates = np.asarray(xyz, dtype=np.float32)
    if coordinates.ndim == 2:
        coordinates = coordinates[np.newaxis]
    if coordinates.ndim != 3 or coordinates.shape[2] != 3:
        raise PointsError(f"coordinates have shape {np.shape(xyz)}; expected (N, 3) or (H, W, 3)")
    points = np.zeros(coordinates.shape[:2], dtype=XYZ if rgb is None else XYZRGB)
    for axis, name in enumerate("xyz"):
        points[name] = coordinates[:, :, axis]
    if rgb is not None:
        points["rgb"] = pack_rgb(rgb).reshape(points.shape)
    return points


def xyz(points: Points) -> NDArray[np.float32]:
    """Coordinates as float32 of shape (H, W, 3), metres; a view without copy where the fields lie side by side.

    Raises:
        PointsError: the cloud has no float x, y, z.
    """
    names = points.dtype.names or ()
    fields: Any = points.dtype.fields or {}
    if any(axis not in names for axis in "xyz"):
        raise PointsError(f"cloud has fields {', '.join(names) or 'none'}; expected x, y and z among them")
    offsets = [fields[axis][1] for axis in "xyz"]
    packed = offsets[1] - offsets[0] == 4 and offsets[2] - offsets[1] == 4
    if packed and all(fields[axis][0] == np.dtype("<f4") for axis in "xyz"):
        side_by_side = np.dtype(
            {"names": ["xyz"], "formats": [("<f4", 3)], "offsets": [offsets[0]], "itemsize": points.dtype.itemsize}
        )
        view: NDArray[np.float32] = points.view(side_by_side)["xyz"]
        return view
    return np.stack([points[axis].astype(np.float32) for axis in "xyz"], axis=-1)


def has_colour(points: Points) -> bool:
    """True where the cloud carries a packed rgb field."""
    return "rgb" in (points.dtype.names or ())


def is_organised(points: Points) -> bool:
    """True where rows and columns are those of an image."""
    return points.ndim == 2 and points.shape[0] > 1


def pack_rgb(rgb: ArrayLike) -> NDArray[np.float32]:
    """Pack (..., 3) uint8 red green blue into float32 bits 0x00RRGGBB, shape (...)."""
    channels = np.asarray(rgb, dtype=np.uint8).astype(np.uint32)
    packed = (channels[..., 0] << 16) | (channels[..., 1] << 8) | channels[..., 2]
    return packed.astype(np.uint32).view(np.float32)


def colours(points: Points) -> NDArray[np.uint8]:
    """Red, green, blue as uint8 of shape (H, W, 3).

    Raises:
        PointsError: the cloud has no rgb field.
    """
    if not has_colour(points):
        raise PointsError(f"cloud has fields {', '.join(points.dtype.names or ()) or 'none'}; expected rgb among them")
    packed = np.ascontiguousarray(points["rgb"]).view(np.uint32)
    return np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=-1).astype(np.uint8)
