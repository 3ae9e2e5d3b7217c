"""Pairs of a colour image and a 16-bit depth image as organised clouds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core import depth_image
from zsight_core.errors import FileError
from zsight_core.files.cloud_file import natural_order
from zsight_core.files.input_file import input_file

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from zsight_core.files.atomic_file import AnyPath
    from zsight_core.files.depth_camera import DepthCamera
    from zsight_core.points import Points

__all__ = ["RgbdPair", "list_pairs", "read"]

_COLOUR_END, _DEPTH_END = "-color", "-depth"
_COLOUR_FOLDER, _DEPTH_FOLDER = "rgb", "depth"
_COLOUR_SUFFIXES = (".png", ".jpg", ".jpeg")
_MAX_RATIO = 1100  # neither PNG (1032) nor JPEG (1024) expands by more


@dataclass(frozen=True)
class RgbdPair:
    """Two images of the same moment: ``colour`` and ``depth``, and the ``name`` that they share."""

    name: str
    colour: Path
    depth: Path


def read(colour: AnyPath, depth: AnyPath, camera: DepthCamera) -> Points:
    """Make a cloud of a pair that was taken from the same place (registered).

    Args:
        colour: PNG or JPEG, 8 bits a channel.
        depth: PNG of 16 bits, units of ``camera.depth_scale``, 0 where nothing was measured.
        camera: intrinsics and unit.

    Returns:
        Points (H, W), XYZRGB, in the camera's optical frame, metres; x, y, z are NaN where nothing was measured.

    Raises:
        FileError: a file is missing, damaged or of another kind; sizes differ between the two or from the camera's.
    """
    pinhole = camera.pinhole
    distances, pixels = _depth_pixels(depth), _colour_pixels(colour)
    if distances.shape != (pinhole.height, pinhole.width):
        raise FileError(depth, f"has {_size(distances)} pixels; the camera has {pinhole.width} x {pinhole.height}")
    if pixels.shape[:2] != distances.shape:
        raise FileError(colour, f"has {_size(pixels)} pixels; its depth image {depth} has {_size(distances)}")
    return depth_image.to_points(distances, pinhole, depth_scale=camera.depth_scale, colour=pixels)


def list_pairs(folder: AnyPath) -> list[RgbdPair]:
    """The pairs in a folder, in natural order; images without a partner are left out.

    Two layouts are known: ``NAME-color.png`` beside ``NAME-depth.png``, and subfolders ``rgb`` and ``depth`` with
    files of the same name. Colour may be JPEG.

    Raises:
        FileError: there is no such folder, or it cannot be read.
    """
    place = Path(folder)
    beside = _match(_images(place, _COLOUR_SUFFIXES), _images(place, (".png",)), _COLOUR_END, _DEPTH_END)
    below = _match(
        _images(place / _COLOUR_FOLDER, _COLOUR_SUFFIXES) if (place / _COLOUR_FOLDER).is_dir() else [],
        _images(place / _DEPTH_FOLDER, (".png",)) if (place / _DEPTH_FOLDER).is_dir() else [],
    )
    return sorted([*beside, *below], key=lambda pair: natural_order(pair.name))


def _images(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.is_file()]
    except OSError as error:
        raise FileError(folder, f"cannot be listed: {error.strerror or error}") from error


def _match(
    colours: Iterable[Path], depths: Iterable[Path], colour_end: str = "", depth_end: str = ""
) -> list[RgbdPair]:
    depth_of = {path.stem.removesuffix(depth_end): path for path in depths if path.stem.endswith(depth_end)}
    named = [(path.stem.removesuffix(colour_end), path) for path in colours if path.stem.endswith(colour_end)]
    return [RgbdPair(name, path, depth_of[name]) for name, path in named if name in depth_of]


def _depth_pixels(path: AnyPath) -> NDArray[np.uint16]:
    mode, pixels = _pixels(path, None)
    if mode not in ("I;16", "I;16B", "I;16L", "I") or pixels.min(initial=0) < 0 or pixels.max(initial=0) > 65535:
        raise FileError(path, f"has pixels of kind {mode}; expected a 16-bit grey image")
    return pixels.astype(np.uint16)


def _colour_pixels(path: AnyPath) -> NDArray[np.uint8]:
    mode, pixels = _pixels(path, "RGB")
    if mode not in ("RGB", "RGBA", "L", "LA", "P"):
        raise FileError(path, f"has pixels of kind {mode}; expected a colour image of 8 bits a channel")
    return pixels.astype(np.uint8, copy=False)


def _pixels(path: AnyPath, convert: str | None) -> tuple[str, NDArray[Any]]:
    """The image's mode as Pillow names it, and its pixels, converted to another mode where asked."""
    from PIL import Image

    with input_file(path) as (file, size):
        try:
            with Image.open(file, formats=("PNG", "JPEG")) as image:
                if image.width * image.height * len(image.getbands()) > _MAX_RATIO * size:
                    raise FileError(path, f"is damaged: {size} bytes cannot hold {image.width} x {image.height} pixels")
                return image.mode, np.asarray(image.convert(convert) if convert else image)
        except (OSError, ValueError, SyntaxError, EOFError) as error:  # what Pillow raises on damaged images
            raise FileError(path, f"cannot be read as an image: {error}") from None
        except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
            raise FileError(path, f"is too large an image: {error}") from None


def _size(image: NDArray[Any]) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
