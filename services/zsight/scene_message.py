"""The scene stage's result as it is sent, and its label image back as an array."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import point, pose_of
from zsight_protocol import scene as message

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from zsight_core.clues import Clues
    from zsight_core.holes import Hole
    from zsight_core.scene import Scene, Segment
    from zsight_core.support import Support
    from zsight_protocol.message import Header

__all__ = ["image_of", "labels_of", "scene_of"]

_RUN = np.dtype([("label", "<i2"), ("length", "<u2")])
_MOST_CORNERS = 200
_SMALLEST_LAYER = 20  # cells of a level piece that something may stand on


def scene_of(scene: Scene, header: Header, types: Mapping[int, str], finder: str = "") -> message.Scene:
    """The message of a scene.

    Args:
        scene: what the scene stage made of a cloud.
        header: the cloud's.
        types: what finds on this cloud have told so far: label of a segment to object type.
        finder: whose scene it is.
    """
    from zsight_core.clues import clues_of

    clues = clues_of(scene)
    is_image = scene.view.pixel is None and max(scene.labels.shape) < 2**15
    return message.Scene(
        header=header,
        finder=finder,
        supports=tuple(_surface(support) for support in scene.supports),
        segments=tuple(_segment(segment, clues, types) for segment in scene.segments),
        missing=tuple(_missing(hole) for hole in scene.holes),
        labels=image_of(scene.labels) if is_image else None,
        timings_ms=scene.timings_ms,
    )


def image_of(labels: NDArray[np.int32]) -> message.LabelImage:
    """The message of labels (H, W), each from -1 and below 2^15."""
    height, width = labels.shape
    starts = np.ones(labels.shape, np.bool_)
    starts[:, 1:] = labels[:, 1:] != labels[:, :-1]
    first = np.flatnonzero(starts)
    runs = np.empty(len(first), _RUN)
    runs["label"] = labels.reshape(-1)[first]
    runs["length"] = np.diff(first, append=labels.size)
    return message.LabelImage(height=height, width=width, runs=runs.tobytes())


def labels_of(image: message.LabelImage) -> NDArray[np.int32]:
    """Labels (H, W) of an image: -1 no data, 0 neither, 1 support surface, 2.. one number a segment.

    Raises:
        ValueError: its runs do not fill it.
    """
    runs = np.frombuffer(image.runs[: len(image.runs) // _RUN.itemsize * _RUN.itemsize], _RUN)
    covered, expected = int(runs["length"].sum(dtype=np.int64)), image.height * image.width
    if covered != expected or len(image.runs) % _RUN.itemsize:
        raise ValueError(f"runs cover {covered} pixels; expected {image.height} x {image.width} = {expected}")
    return np.repeat(runs["label"].astype(np.int32), runs["length"]).reshape(image.height, image.width)


def _surface(support: Support) -> message.SupportSurface:
    return message.SupportSurface(
        pose=pose_of(support.T_camera_support),
        outline=_corners(support.outline),
        area=float(support.area),
        points=int(support.inliers),
        rms=float(support.rms),
        height=None if support.height is None else float(support.height),
    )


def _segment(segment: Segment, clues: Clues, types: Mapping[int, str]) -> message.SceneSegment:
    length, width, height = (max(float(edge), 0.0) for edge in segment.size)
    return message.SceneSegment(
        label=segment.label,
        support=segment.support,
        points=segment.points,
        centroid=point(segment.centroid),
        pose=pose_of(segment.T_camera_box),
        size=(length, width, height),
        low=float(segment.low),
        high=float(segment.high),
        layers=_layers(segment, clues),
        type=types.get(segment.label, ""),
    )


def _layers(segment: Segment, clues: Clues) -> tuple[message.HeightLayer, ...]:
    """Level tops of a segment, the lowest first."""
    from zsight_core.support import outline_of

    tops = [layer for layer in clues.layers if layer.segment == segment.label and len(layer.points) >= _SMALLEST_LAYER]
    return tuple(
        message.HeightLayer(height=layer.height, outline=_corners(outline_of(layer.points[:, :2])))
        for layer in sorted(tops, key=lambda layer: layer.height)
    )


def _missing(hole: Hole) -> message.MissingDepth:
    length, width = (float(edge) for edge in hole.size)
    return message.MissingDepth(
        support=hole.support,
        pose=pose_of(hole.T_camera_box),
        size=(length, width),
        area=float(hole.area),
        is_shadow=hole.is_shadow,
    )


def _corners(outline: NDArray[np.float64]) -> tuple[tuple[float, float], ...]:
    """Corners of an outline (K, 2); of one with more than enough, some of them."""
    some = outline[:: -(-len(outline) // _MOST_CORNERS)] if len(outline) else outline
    return tuple((float(x), float(y)) for x, y in some)
