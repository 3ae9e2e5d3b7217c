"""A picture of a cloud: points from an eye, shaded by depth, with drawings on top."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from zsight_core.errors import GeometryError
from zsight_core.files.atomic_file import AnyPath, atomic_file
from zsight_core.picture.canvas import overlay
from zsight_core.picture.eye import Eye, Projection, own_eye
from zsight_core.picture.shading import shade_by_depth
from zsight_core.picture.surface import paint
from zsight_core.points import from_xyz

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from zsight_core.picture.drawings import Drawing
    from zsight_core.points import Points

__all__ = ["draw", "png_of", "save_png", "warm_up"]

SKY, FLOOR = np.array([38, 44, 54], dtype=np.float64), np.array([16, 19, 24], dtype=np.float64)


def draw(
    points: Points, drawings: Sequence[Drawing] = (), eye: Eye | None = None, size: tuple[int, int] = (1280, 720)
) -> NDArray[np.uint8]:
    """Picture of a cloud.

    Args:
        points: (H, W) cloud; an organised one is drawn as a surface, another as discs.
        drawings: outlines, triads, legends, placed in the frame of the points.
        eye: where it is seen from; left out: the camera that took it.
        size: width and height, pixels.

    Returns:
        (height, width, 3) uint8, red green blue.

    Raises:
        GeometryError: the size is not at least 16 x 16.
        PointsError: the cloud has no x, y, z.
    """
    width, height = size
    if width < 16 or height < 16:
        raise GeometryError(f"picture size is {width} x {height}; expected at least 16 x 16 pixels")
    projection = Projection.of(eye or own_eye(points, size), width, height)
    image = _background(width, height)
    depth = np.full((height, width), np.inf, dtype=np.float32)
    paint(points, projection, image, depth)
    shade_by_depth(depth, image)
    return overlay(image, tuple(drawings), projection) if drawings else image


def save_png(path: AnyPath, image: NDArray[np.uint8], *, overwrite: bool = True) -> None:
    """Write an image (height, width, 3) uint8 as PNG; the file appears whole or not at all.

    Raises:
        FileError: it cannot be written.
    """
    with atomic_file(path, overwrite=overwrite) as file:
        file.write(png_of(image))


def png_of(image: NDArray[np.uint8]) -> bytes:
    """An image (height, width, 3) uint8 as the bytes of a PNG file."""
    encoded = io.BytesIO()
    Image.fromarray(image).save(encoded, format="PNG", compress_level=6)
    return encoded.getvalue()


def warm_up() -> None:
    """Compile the kernels of pictures, or load them from the cache."""
    v, u = np.mgrid[0:4, 0:4]
    xyz = np.stack([u * 0.01, v * 0.01, np.ones((4, 4))], axis=-1)
    rgb = np.zeros((4, 4, 3), dtype=np.uint8)
    for cloud in (from_xyz(xyz, rgb), from_xyz(xyz), from_xyz(xyz.reshape(-1, 3))):
        draw(cloud, size=(16, 16))


def _background(width: int, height: int) -> NDArray[np.uint8]:
    share = np.linspace(0, 1, height)[:, None]
    rows = (SKY * (1 - share) + FLOOR * share).astype(np.uint8)
    return np.repeat(rows, width, axis=0).reshape(height, width, 3)
