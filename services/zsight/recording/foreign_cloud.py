"""Clouds that others recorded, as they are legal here: little-endian, rows without padding."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

__all__ = ["tidy"]

_SIZES = (0, 1, 1, 2, 2, 4, 4, 4, 8)


def tidy(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """The values of a PointCloud2 with rows side by side and little-endian numbers; as they are where they are so."""
    height, width, step = values["height"], values["width"], values["point_step"]
    is_tight = values["row_step"] == width * step and len(values["data"]) == height * width * step
    if is_tight and not values["is_bigendian"]:
        return values
    rows = np.frombuffer(values["data"], np.uint8)
    row_step = values["row_step"] or width * step
    if rows.size < height * row_step or row_step < width * step:
        return values  # refused, with its reason, where messages are checked
    points = np.ascontiguousarray(rows[: height * row_step].reshape(height, row_step)[:, : width * step])
    if values["is_bigendian"]:
        _swap(points.reshape(height * width, step), values["fields"])
    return {**values, "row_step": width * step, "is_bigendian": False, "data": points.reshape(-1).data}


def _swap(points: NDArray[np.uint8], fields: list[Mapping[str, Any]]) -> None:
    """Turn the bytes of every number around, in place."""
    for field in fields:
        size = _SIZES[field["datatype"]] if field["datatype"] < len(_SIZES) else 0
        for number in range(field["count"] if size > 1 else 0):
            start = field["offset"] + number * size
            points[:, start : start + size] = points[:, start : start + size][:, ::-1].copy()
