"""The pinhole model of a camera: where a point of its optical frame falls in its image."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Pinhole"]


@dataclass(frozen=True)
class Pinhole:
    """Image size and intrinsics, all in pixels; the centre of the first pixel is (0, 0)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
