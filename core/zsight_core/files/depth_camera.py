"""The camera behind a folder of depth images: a pinhole and the unit of its depth, from a small file."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zsight_core.errors import FileError, GeometryError
from zsight_core.files.input_file import input_file
from zsight_core.pinhole import Distortion, Pinhole

if TYPE_CHECKING:
    from zsight_core.files.atomic_file import AnyPath

__all__ = ["FILE_NAMES", "DepthCamera", "find", "read"]

FILE_NAMES = ("camera.toml", "camera.json")

_NUMBERS = ("fx", "fy", "cx", "cy")
_SIDES = ("width", "height")
_LARGEST_FILE = 1 << 20
_LARGEST_SIDE = 1 << 16


@dataclass(frozen=True)
class DepthCamera:
    """``pinhole`` of the depth image; ``depth_scale`` metres a unit of a 16-bit depth image."""

    pinhole: Pinhole
    depth_scale: float = 0.001


def read(path: AnyPath) -> DepthCamera:
    """Read a camera from TOML or JSON, by the suffix.

    Keys: ``width height`` pixels; ``fx fy cx cy`` pixels, the centre of the first pixel is (0, 0); ``depth_scale``
    metres a unit, 0.001 if left out; ``distortion`` k1 k2 p1 p2 k3, none if left out.

    Raises:
        FileError: no such file, not TOML or JSON, a key is missing, unknown or makes no sense.
    """
    entries = _entries(path)
    unknown = set(entries) - {*_SIDES, *_NUMBERS, "depth_scale", "distortion"}
    missing = [key for key in (*_SIDES, *_NUMBERS) if key not in entries]
    if unknown or missing:
        raise FileError(path, f"lacks the keys {missing} and has unknown ones {sorted(unknown)}; expected "
                              "width height fx fy cx cy, perhaps depth_scale and distortion")  # fmt: skip
    width, height = (_side(entries, key, path) for key in _SIDES)
    fx, fy, cx, cy = (_number(entries[key], key, path) for key in _NUMBERS)
    scale = _number(entries.get("depth_scale", 0.001), "depth_scale", path)
    if not 0 < scale <= 1:
        raise FileError(path, f"depth_scale is {scale}; expected metres a unit, such as 0.001")
    try:
        return DepthCamera(Pinhole(width, height, fx, fy, cx, cy, _distortion(entries, path)), scale)
    except GeometryError as error:
        raise FileError(path, f"{error}") from None


def find(folder: AnyPath) -> DepthCamera | None:
    """The camera of a folder that has a camera.toml or camera.json; None where there is neither.

    Raises:
        FileError: the file makes no sense.
    """
    for name in FILE_NAMES:
        if (Path(folder) / name).is_file():
            return read(Path(folder) / name)
    return None


def _entries(path: AnyPath) -> dict[str, Any]:
    with input_file(path) as (file, size):
        if size > _LARGEST_FILE:
            raise FileError(path, f"has {size} bytes; that is no camera file")
        text = file.read()
    parse = tomllib.loads if Path(path).suffix.lower() == ".toml" else json.loads
    try:
        entries = parse(text.decode())
    except (ValueError, RecursionError) as error:  # both parsers' errors, and that of bytes that are no text
        raise FileError(path, f"cannot be understood: {error}") from None
    if not isinstance(entries, dict):
        raise FileError(path, "holds no keys; expected width height fx fy cx cy")
    return entries


def _number(value: object, key: str, path: AnyPath) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        raise FileError(path, f"{key} is {value!r}; expected a number")
    return float(value)


def _side(entries: dict[str, Any], key: str, path: AnyPath) -> int:
    value = entries[key]
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= _LARGEST_SIDE:
        raise FileError(path, f"{key} is {value!r}; expected a whole number of pixels, 1 to {_LARGEST_SIDE}")
    return value


def _distortion(entries: dict[str, Any], path: AnyPath) -> Distortion | None:
    values = entries.get("distortion")
    if values is None:
        return None
    if not isinstance(values, list) or len(values) != 5:
        raise FileError(path, f"distortion is {values!r}; expected five numbers: k1 k2 p1 p2 k3")
    k1, k2, p1, p2, k3 = (_number(value, "distortion", path) for value in values)
    return (k1, k2, p1, p2, k3)
