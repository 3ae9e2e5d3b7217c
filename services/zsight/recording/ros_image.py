"""Images that others recorded, as far as clouds are made of them."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, PlainValidator

from zsight_protocol.errors import DecodeError
from zsight_protocol.message import Header, Message

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CompressedImage", "Image", "colour_pixels", "depth_metres"]

_Bytes = Annotated[bytes | memoryview, PlainValidator(lambda data: data)]
_DEPTH = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
_COLOUR = {"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0)),
           "mono8": (1, (0, 0, 0)), "8UC1": (1, (0, 0, 0)), "8UC3": (3, (2, 1, 0))}  # fmt: skip


class Image(Message):
    """sensor_msgs/Image."""

    header: Header
    height: Annotated[int, Field(ge=1, lt=2**16)]
    width: Annotated[int, Field(ge=1, lt=2**16)]
    encoding: str
    is_bigendian: int
    step: int
    data: _Bytes


class CompressedImage(Message):
    """sensor_msgs/CompressedImage: PNG or JPEG."""

    header: Header
    format: str
    data: _Bytes


def depth_metres(image: Image | CompressedImage) -> tuple[NDArray[np.uint16] | NDArray[np.float32], float]:
    """Depth (H, W) as it was recorded, and metres a unit.

    Raises:
        DecodeError: it is no depth image.
    """
    if isinstance(image, CompressedImage):
        # compressed_depth_image_transport puts 12 bytes before its PNG
        data = bytes(image.data)
        pixels = _opened(data[data.find(b"\x89PNG") :] if b"\x89PNG" in data[:64] else data)
        if pixels.ndim != 2 or pixels.dtype.itemsize < 2:
            raise DecodeError(f"a compressed depth image of {pixels.dtype}; expected a PNG of 16 bits")
        return pixels.astype(np.uint16), 0.001
    if image.encoding not in _DEPTH:
        raise DecodeError(f"the encoding of a depth image is {image.encoding!r}; expected one of {', '.join(_DEPTH)}")
    form, scale = _DEPTH[image.encoding]
    dtype = np.dtype(form).newbyteorder(">" if image.is_bigendian else "<")
    return np.ascontiguousarray(_rows(image, dtype.itemsize).view(dtype).astype(form)), scale


def colour_pixels(image: Image | CompressedImage) -> NDArray[np.uint8]:
    """Red, green, blue (H, W, 3).

    Raises:
        DecodeError: the encoding is not known.
    """
    if isinstance(image, CompressedImage):
        pixels = _opened(bytes(image.data), "RGB")
        return pixels.astype(np.uint8)
    if image.encoding not in _COLOUR:
        raise DecodeError(f"the encoding of an image is {image.encoding!r}; expected one of {', '.join(_COLOUR)}")
    channels, order = _COLOUR[image.encoding]
    rows = _rows(image, channels).reshape(image.height, image.width, channels)
    return np.ascontiguousarray(rows[:, :, list(order)])


def _rows(image: Image, pixel: int) -> NDArray[np.uint8]:
    """Bytes (H, W * pixel) without padding."""
    data = np.frombuffer(image.data, np.uint8)
    step = image.step or image.width * pixel
    if data.size < image.height * step or step < image.width * pixel:
        raise DecodeError(f"an image of {image.width} x {image.height} has {data.size} bytes; expected more")
    rows = data[: image.height * step].reshape(image.height, step)[:, : image.width * pixel]
    return np.ascontiguousarray(rows)


def _opened(data: bytes, mode: str = "") -> NDArray[np.generic]:
    from PIL import Image as pillow  # noqa: N813  the module

    try:
        with pillow.open(io.BytesIO(data)) as opened:
            return np.asarray(opened.convert(mode) if mode else opened)
    except (OSError, ValueError) as error:
        raise DecodeError(f"a compressed image cannot be read: {error}") from None
