"""Depth images to organised clouds and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core.errors import PointsError
from zsight_core.jit import njit
from zsight_core.pinhole import Pinhole
from zsight_core.points import XYZ, XYZRGB, xyz
from zsight_core.take import array_for

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

__all__ = ["from_points", "to_points", "warm_up"]

_LARGEST = 65535


def to_points(
    depth: NDArray[Any],
    pinhole: Pinhole,
    *,
    depth_scale: float = 1.0,
    colour: NDArray[np.uint8] | None = None,
    out: Points | None = None,
) -> Points:
    """Put each pixel of a depth image where it was measured.

    Args:
        depth: (H, W) distance along the optical axis: uint16 in units of ``depth_scale`` (0: nothing measured), or
            float in metres (NaN, infinite, zero or less: nothing measured).
        pinhole: the camera, of the image's size; its distortion is undone.
        depth_scale: metres a unit of a uint16 image, such as 0.001; 1.0 for a float image.
        colour: (H, W, 3) uint8 red green blue, seen from the same place.
        out: XYZRGB or XYZ points (H, W) to fill, contiguous; left out: new ones.

    Returns:
        Points (H, W) in the optical frame, metres, XYZRGB or, without colour, XYZ; x, y, z are NaN where nothing was
        measured, the colour stays.

    Raises:
        PointsError: sizes or types do not fit.
    """
    _require_image(depth, pinhole, depth_scale)
    if colour is not None and (colour.shape != (*depth.shape, 3) or colour.dtype != np.uint8):
        raise PointsError(
            f"colour image has shape {colour.shape} and type {colour.dtype}; expected {(*depth.shape, 3)} and uint8"
        )
    dtype = XYZ if colour is None else XYZRGB
    points = np.empty(depth.shape, dtype) if out is None else out
    if points.dtype != dtype or points.shape != depth.shape or not points.flags.c_contiguous:
        raise PointsError(f"output has shape {points.shape}, type {points.dtype}; expected {depth.shape} and {dtype}")
    image = np.ascontiguousarray(depth if depth.dtype == np.uint16 else depth.astype(np.float32, copy=False))
    words = points.view(np.dtype("<f4")).reshape(*depth.shape, 4)
    _fill(image, np.float64(depth_scale), *_ray_tables(pinhole), words)
    if colour is not None:
        _paint(np.ascontiguousarray(colour), words.view(np.uint32))
    else:
        words[..., 3] = 0
    return points


def from_points(
    points: Points, pinhole: Pinhole, *, depth_scale: float | None = None, out: NDArray[Any] | None = None
) -> NDArray[Any]:
    """What a camera at the cloud's origin sees: the nearest point in each pixel.

    Args:
        points: (H, W), organised or not, in the camera's optical frame, metres.
        pinhole: the camera; its distortion is applied.
        depth_scale: metres a unit, for a uint16 image; left out: a float image in metres.
        out: room for the result, contiguous.

    Returns:
        Depth (pinhole.height, pinhole.width): float32, NaN where no point falls; or uint16, 0 where none falls or the
        distance is beyond 65535 units.

    Raises:
        PointsError: the cloud has no x, y, z; the scale is not above zero; `out` does not fit.
    """
    if depth_scale is not None and not (np.isfinite(depth_scale) and depth_scale > 0):
        raise PointsError(f"depth scale is {depth_scale}; expected metres a unit, above zero")
    coordinates = xyz(points).reshape(-1, 3)
    shape = (pinhole.height, pinhole.width)
    found = array_for(shape, np.float32 if depth_scale is None else np.uint16, out)
    depth = found if depth_scale is None else np.empty(shape, np.float32)
    depth[:] = np.inf
    distortion = np.array(pinhole.distortion or (0.0,) * 5)
    _project(coordinates, pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy, distortion, depth)
    depth[np.isinf(depth)] = np.nan
    if depth_scale is not None:
        found[:] = _in_units(depth, depth_scale)
    return found


def warm_up() -> None:
    """Compile the kernels, or load them from the cache."""
    colour = np.zeros((2, 2, 3), np.uint8)
    for distortion in (None, (0.1, 0.0, 0.0, 0.0, 0.0)):
        pinhole = Pinhole(2, 2, 2.0, 2.0, 0.5, 0.5, distortion)
        for depth in (np.ones((2, 2), np.uint16), np.ones((2, 2), np.float32)):
            from_points(to_points(depth, pinhole, colour=colour), pinhole)


def _require_image(depth: NDArray[Any], pinhole: Pinhole, depth_scale: float) -> None:
    if depth.dtype != np.uint16 and depth.dtype.kind != "f":
        raise PointsError(f"depth image has type {depth.dtype}; expected uint16 or float metres")
    if depth.shape != (pinhole.height, pinhole.width):
        raise PointsError(f"depth image has shape {depth.shape}; the camera's is {(pinhole.height, pinhole.width)}")
    if not (np.isfinite(depth_scale) and depth_scale > 0):
        raise PointsError(f"depth scale is {depth_scale}; expected metres a unit, above zero")


def _ray_tables(pinhole: Pinhole) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The rays' x / z and y / z as (H, W); where they depend on column or row alone, as (1, W) and (H, 1)."""
    if pinhole.distortion is None:
        across = (np.arange(pinhole.width, dtype=np.float64) - pinhole.cx) / pinhole.fx
        down = (np.arange(pinhole.height, dtype=np.float64) - pinhole.cy) / pinhole.fy
        return across[np.newaxis], down[:, np.newaxis]
    rays = pinhole.rays()
    return np.ascontiguousarray(rays[..., 0]), np.ascontiguousarray(rays[..., 1])


def _in_units(depth: NDArray[np.float32], depth_scale: float) -> NDArray[np.uint16]:
    units = np.rint(depth.astype(np.float64) / depth_scale)
    return np.where(units <= _LARGEST, units, 0).astype(np.uint16)


@njit(cache=True, nogil=True)
def _fill(depth: Any, scale: float, across: Any, down: Any, words: Any) -> None:
    height, width = depth.shape
    plain = across.shape[0] == 1
    for v in range(height):
        for u in range(width):
            z = depth[v, u] * scale
            if not (z > 0.0 and z < np.inf):
                z = np.nan
            words[v, u, 0] = across[0 if plain else v, u] * z
            words[v, u, 1] = down[v, 0 if plain else u] * z
            words[v, u, 2] = z


@njit(cache=True, nogil=True)
def _paint(colour: Any, words: Any) -> None:
    height, width, _ = colour.shape
    for v in range(height):
        for u in range(width):
            red, green, blue = np.uint32(colour[v, u, 0]), np.uint32(colour[v, u, 1]), np.uint32(colour[v, u, 2])
            words[v, u, 3] = red << np.uint32(16) | green << np.uint32(8) | blue


@njit(cache=True, nogil=True)
def _project(xyz: Any, fx: float, fy: float, cx: float, cy: float, distortion: Any, depth: Any) -> None:
    height, width = depth.shape
    k1, k2, p1, p2, k3 = distortion
    for i in range(len(xyz)):
        z = np.float64(xyz[i, 2])
        if not (z > 0.0 and z < np.inf):
            continue
        x, y = xyz[i, 0] / z, xyz[i, 1] / z
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        u = fx * (x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)) + cx
        v = fy * (y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y) + cy
        if -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5:
            row, column = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
            if z < depth[row, column]:
                depth[row, column] = z
