"""Clouds in other layouts: fewer fields, PCL's 32-byte points, several clouds in one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import PointsError
from zsight_core.points import XYZ, XYZRGB
from zsight_core.take import array_for, room_for
from zsight_core.words import colour_field

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from zsight_core.points import Points

__all__ = ["PCL_XYZRGB", "concatenate", "repack", "select_fields", "to_packed", "to_pcl_layout"]

PCL_XYZRGB = np.dtype(
    {"names": ["x", "y", "z", "rgb"], "formats": ["<f4"] * 4, "offsets": [0, 4, 8, 16], "itemsize": 32}
)
"""A PCL PointXYZRGB, as ROS drivers send it."""


def repack(points: Points, dtype: np.dtype[Any]) -> Points:
    """The cloud in another record layout: same-named fields are carried over, missing ones are zero.

    Numbers are converted; a colour (rgb, rgba) is carried over bit for bit, whatever number type it is declared as.

    Args:
        points: (H, W), any layout.
        dtype: the layout wanted.

    Returns:
        Points (H, W) of that dtype; the input itself where it has it already.
    """
    if points.dtype == dtype:
        return points
    result = np.zeros(points.shape, dtype)
    source = colour_field(points)
    target = colour_field(result)
    for name in dtype.names or ():
        if name == target and source is not None:
            result[name] = _same_bits(points[source], dtype[name])
        elif name in (points.dtype.names or ()):
            result[name] = points[name]
    return result


def to_packed(points: Points) -> Points:
    """The cloud as 16-byte XYZRGB, or XYZ where it has no colour; the input itself where it is so already."""
    return repack(points, XYZRGB if colour_field(points) else XYZ)


def to_pcl_layout(points: Points) -> Points:
    """The cloud as PCL's 32-byte PointXYZRGB (`PCL_XYZRGB`)."""
    return repack(points, PCL_XYZRGB)


def select_fields(points: Points, names: Sequence[str], out: Points | None = None) -> Points:
    """Only these fields, in this order, tightly packed.

    Raises:
        PointsError: the cloud lacks one of them; `out`, room for the result, does not fit.
    """
    missing = [name for name in names if name not in (points.dtype.names or ())]
    if missing:
        raise PointsError(f"cloud has fields {', '.join(points.dtype.names or ()) or 'none'}; no {', '.join(missing)}")
    packed = np.dtype([(name, points.dtype[name]) for name in names])
    result = array_for(points.shape, packed, out)
    for name in names:
        result[name] = points[name]
    return result


def concatenate(clouds: Iterable[Points], out: Points | None = None) -> Points:
    """All points of several clouds, one cloud after the other: (1, N), in the layout of the first.

    The clouds must share a frame. A field that only a later cloud has is dropped, one that only the first has is zero
    in the others. `out` is room for the result, contiguous, at least N points; the result is then a view of it.

    Raises:
        PointsError: there is no cloud; `out` does not fit.
    """
    parts = list(clouds)
    if not parts:
        raise PointsError("no clouds to concatenate; expected at least one")
    dtype = parts[0].dtype
    whole = np.dtype((np.void, dtype.itemsize))  # numpy copies a record with fields one field at a time
    count = sum(part.size for part in parts)
    result = room_for(parts[0], count, out)[:, :count]
    start = 0
    for part in parts:
        records = repack(part, dtype).reshape(-1)
        result.view(whole)[0, start : start + part.size] = records.view(whole)
        start += part.size
    return result


def _same_bits(colour: np.ndarray[Any, Any], dtype: np.dtype[Any]) -> np.ndarray[Any, Any]:
    """The packed colour in another 4-byte number type: the bits stay, the byte order is that of `dtype`."""
    if colour.dtype.itemsize != 4 or dtype.itemsize != 4:
        raise PointsError(f"colour has type {colour.dtype} and should get {dtype}; expected four bytes in both")
    native = np.ascontiguousarray(colour).view(np.dtype("<u4" if colour.dtype.str[0] != ">" else ">u4"))
    swapped = native.astype("<u4" if dtype.str[0] != ">" else ">u4")
    return swapped.view(dtype)
