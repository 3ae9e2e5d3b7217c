"""The scene as the finders see it: what things stand on, what stands there, and where nothing was measured."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, Strict

from zsight_protocol.geometry import Point, Pose
from zsight_protocol.message import Count, Float64, Header, Message, Tuple2

__all__ = ["HeightLayer", "LabelImage", "MissingDepth", "Scene", "SceneSegment", "SupportSurface"]

Outline = Annotated[tuple[Tuple2, ...], Strict(False), Field(max_length=1000)]
Extent = Annotated[Float64, Field(ge=0)]
SurfaceNumber = Annotated[int, Field(ge=0, lt=256)]


class SupportSurface(Message):
    """A plane that things stand on.

    ``pose`` is its frame: origin on it, z up along its normal. ``outline`` is the convex outline of what is seen of it,
    counter-clockwise, x and y in that frame, metres; ``area`` what lies within, square metres; ``rms`` the distance of
    its points, metres. ``height`` is its z in the world, metres, where that is known.
    """

    pose: Pose
    outline: Outline = ()
    area: Extent
    points: Count
    rms: Extent
    height: Float64 | None = None


class HeightLayer(Message):
    """A level top within a segment, on which something else may stand: metres above the surface, and its outline.

    The outline is given in the frame of the surface, as that of the surface itself.
    """

    height: Float64
    outline: Outline = ()


class SceneSegment(Message):
    """What is one thing as far as its form tells.

    ``label`` is its number in the label image. ``pose`` and ``size`` are those of a box around it, z along the normal
    of the surface, metres; ``low`` and ``high`` the heights above that surface between which it was seen. ``type`` is
    the object type that a find explained it by; empty: it is an unknown obstacle.
    """

    label: Annotated[int, Field(ge=2, lt=2**15)]
    support: SurfaceNumber
    points: Count
    centroid: Point
    pose: Pose
    size: Annotated[tuple[Extent, Extent, Extent], Strict(False)]
    low: Float64
    high: Float64
    layers: Annotated[tuple[HeightLayer, ...], Strict(False)] = ()
    type: str = ""


class MissingDepth(Message):
    """A region of a surface where nothing was measured: nothing may be said to be absent from it.

    ``pose`` and ``size`` are those of a rectangle around it on the surface, metres; ``area`` what is missing, square
    metres. Where objects border it, it is likely their shadow; else something may be there that returns no light.
    """

    support: SurfaceNumber
    pose: Pose
    size: Annotated[tuple[Extent, Extent], Strict(False)]
    area: Extent
    is_shadow: bool = False


class LabelImage(Message):
    """What each pixel of an organised cloud is: -1 no data, 0 neither, 1 support surface, 2.. label of a segment.

    ``runs`` are pairs of little-endian 16-bit numbers, label and length of a run; a run ends with its row.
    """

    height: Annotated[int, Field(ge=1, lt=2**15)]
    width: Annotated[int, Field(ge=1, lt=2**15)]
    runs: bytes


class Scene(Message):
    """What one cloud shows, in the frame and at the time of that cloud; surfaces and regions come largest first.

    ``labels`` is there where the cloud is an image.
    """

    header: Header
    finder: str = ""
    supports: Annotated[tuple[SupportSurface, ...], Strict(False)] = ()
    segments: Annotated[tuple[SceneSegment, ...], Strict(False)] = ()
    missing: Annotated[tuple[MissingDepth, ...], Strict(False)] = ()
    labels: LabelImage | None = None
    timings_ms: dict[str, Float64] = Field(default_factory=dict)
