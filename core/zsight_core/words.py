"""A cloud seen as a flat run of 32-bit words, the form in which every kernel reads it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from zsight_core.errors import PointsError
from zsight_core.points import XYZ, XYZRGB

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["Layout", "Words", "as_points", "colour_field", "record_words", "words_of"]

Layout = tuple[int, int, int, int]
"""Words a point, and the word at which x, y and z stand."""

_WORD = np.dtype("<f4")
_COLOURS = ("rgb", "rgba")


@dataclass(frozen=True)
class Words:
    """A cloud for kernels: they read ``words[layout[0] * i + layout[1 + axis]]`` and never write.

    ``words`` float32 (count * words a point,); ``colour`` the word of the packed rgb within a point, -1 without;
    ``shape`` that of the cloud, (H, W).
    """

    words: NDArray[np.float32]
    layout: Layout
    colour: int
    shape: tuple[int, int]

    @property
    def count(self) -> int:
        """Number of points, holes included."""
        return self.shape[0] * self.shape[1]


def words_of(cloud: Points | NDArray[np.floating[Any]]) -> Words:
    """The cloud's own memory where it allows, else a packed copy of x, y, z and rgb.

    The memory is used as it is when the array is contiguous, aligned, of the machine's byte order, a point is a
    multiple of 4 bytes and x, y, z are float32 at multiples of 4; field order and padding do not matter.

    Args:
        cloud: Points (H, W) or (N,), or plain coordinates (N, 3) or (H, W, 3), metres.

    Raises:
        PointsError: no x, y, z; not numbers; or another shape.
    """
    points: Points = cast("Points", cloud) if cloud.dtype.names else as_points(cast("NDArray[np.floating[Any]]", cloud))
    if points.ndim not in (1, 2):
        raise PointsError(f"cloud has shape {points.shape}; expected (height, width) or (count,)")
    layout, colour = _layout(points.dtype)
    height, width = points.shape if points.ndim == 2 else (1, len(points))
    if layout[0]:
        if not points.flags.c_contiguous:
            whole = np.dtype((np.void, points.dtype.itemsize))  # numpy copies a record with fields one field at a time
            points = np.ascontiguousarray(points.view(whole)).view(points.dtype)
        words = record_words(points)
        if words.flags.aligned:
            return Words(words, layout, colour, (height, width))
    points = _packed(points, colour_field(points))
    return Words(record_words(points), *_layout(points.dtype), (height, width))


def record_words(points: Points) -> NDArray[np.float32]:
    """Flat float32 view of a contiguous cloud whose points are multiples of 4 bytes; a view also of read-only memory.

    Numba compiles a second version of a kernel for read-only arrays; a cloud off the wire is read-only, and nothing
    may be compiled while a request waits. The view is therefore always declared writable; kernels do not write to it.
    """
    if points.size == 0:
        return np.empty(0, np.float32)
    flat: NDArray[np.float32] = points.reshape(-1).view(_WORD)
    return flat if flat.flags.writeable else np.asarray(_Writable(flat))


def as_points(coordinates: NDArray[np.floating[Any]]) -> Points:
    """Coordinates (N, 3) or (H, W, 3) as Points with the fields x, y, z, 12 bytes a point; a view of float32.

    Raises:
        PointsError: another shape, or not numbers.
    """
    if coordinates.ndim not in (2, 3) or coordinates.shape[-1] != 3 or coordinates.dtype.kind not in "fiu":
        raise PointsError(
            f"coordinates have shape {coordinates.shape} and type {coordinates.dtype}; expected numbers of shape "
            "(N, 3) or (H, W, 3), or a cloud with the fields x, y, z"
        )
    packed = np.ascontiguousarray(coordinates, dtype=np.float32)
    return packed.view(np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))[..., 0]


def colour_field(points: Points) -> str | None:
    """Name of the field that packs the colour: rgb, or rgba as some files name it; None without."""
    names = points.dtype.names or ()
    return next((name for name in _COLOURS if name in names), None)


class _Writable:
    """Declares the memory of a read-only array writable, and keeps it alive."""

    def __init__(self, array: NDArray[np.float32]) -> None:
        self.array = array
        facts = array.__array_interface__
        self.__array_interface__ = {**facts, "data": (facts["data"][0], False)}


@lru_cache(maxsize=64)
def _layout(dtype: np.dtype[Any]) -> tuple[Layout, int]:
    """Layout of a record and the word of its colour (-1 without); zeros for a record that is not made of words."""
    names, fields = dtype.names or (), cast("dict[str, tuple[np.dtype[Any], int]]", dtype.fields or {})
    if any(axis not in names for axis in "xyz"):
        raise PointsError(f"cloud has fields {', '.join(names) or 'none'}; expected x, y and z among them")
    for axis in "xyz":
        if fields[axis][0].kind not in "fiu":
            raise PointsError(f"field {axis} has type {fields[axis][0]}; expected one number a point")
    colour = next((name for name in _COLOURS if name in names), None)
    wordy = dtype.itemsize % 4 == 0 and all(fields[axis][0] == _WORD and fields[axis][1] % 4 == 0 for axis in "xyz")
    if colour is not None:
        kind, offset = fields[colour][:2]
        if kind.shape:
            raise PointsError(f"field {colour} holds {kind.shape} numbers a point; expected four bytes: 0x00RRGGBB")
        wordy = wordy and kind.itemsize == 4 and kind.isnative and offset % 4 == 0
    if not wordy:
        return (0, 0, 0, 0), -1
    layout = (dtype.itemsize // 4, fields["x"][1] // 4, fields["y"][1] // 4, fields["z"][1] // 4)
    return layout, -1 if colour is None else fields[colour][1] // 4


def _packed(points: Points, colour: str | None) -> Points:
    """A copy with x, y, z (and the colour, bit for bit) in the 16-byte layout."""
    copy = np.empty(points.shape, XYZRGB if colour else XYZ)
    for axis in "xyz":
        copy[axis] = points[axis]
    if colour:
        bits = points[colour]
        if bits.dtype.itemsize != 4:
            raise PointsError(f"field {colour} has type {bits.dtype}; expected four bytes: 0x00RRGGBB")
        native = np.ascontiguousarray(bits.astype(bits.dtype.newbyteorder("=")))
        copy["rgb"] = native.view(np.float32)
    return copy
