"""Make an object type of a thing that stands before a camera: what is measured, chosen and drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import pose_of
from zsight.errors import UsageError
from zsight_core import picture
from zsight_core.model import Box, Cylinder, Sphere
from zsight_core.points import colours, has_colour
from zsight_core.shape_measurement import SHAPES, measure_shape
from zsight_core.transform import inverse, transform_xyz
from zsight_protocol.object_type import BoxShape, CylinderShape, ObjectType, ShapeOf, SphereShape, Taught

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.model import Shape
    from zsight_core.points import Points
    from zsight_core.scene import Scene, Segment
    from zsight_core.shape_measurement import Measurement
    from zsight_protocol.message import Header
    from zsight_protocol.object_type import Teaching

__all__ = ["teach"]

LEAST_EXPLAINED = 0.7
"""Share of pixels that a shape must explain to be taken for the thing's."""

NEAR = 0.05
"""Metres around a segment's box within which a place is taken to mean it."""

_PICTURE = (640, 480)
_DIGITS = 4  # tenths of a millimetre: more is not measured


def teach(
    name: str, asked: Teaching, points: Points, scene: Scene, header: Header, T_frame_camera: NDArray[np.float64]
) -> tuple[ObjectType, Taught]:
    """The type of a thing in a cloud, and how it was measured.

    Args:
        name: of the new type.
        asked: which thing, and what is known of it.
        points: (H, W) cloud, camera frame, metres.
        scene: what the scene stage made of it.
        header: stamp of the cloud, and the frame of ``asked.place`` and of the answer.
        T_frame_camera: (4, 4) the camera in that frame.

    Raises:
        UsageError: no thing or several are meant, or no shape fits.
        GeometryError: the view does not show all dimensions.
    """
    segment = _meant(asked, scene, T_frame_camera)
    measured = measure_shape(scene, segment, asked.shape)
    if measured.explained < LEAST_EXPLAINED:
        told = ", ".join(f"{shape} {share:.0%}" for shape, share in measured.explained_by.items())
        raise UsageError(
            f"no shape explains the thing ({told}; expected {LEAST_EXPLAINED:.0%}): put it by itself where all of it is"
            " seen, or give a mesh of it with: zsight catalog add FILE"
        )
    kind = ObjectType(
        name=name,
        code=asked.code,
        shape=_shape_of(measured.shape),
        colour=_colour_of(points, scene, segment),
        notes=asked.notes,
    )
    taught = Taught(
        header=header,
        pose=pose_of(T_frame_camera @ measured.T_camera_model),
        explained=measured.explained,
        misfit=measured.misfit,
        explained_by=measured.explained_by,
        picture=_picture_of(name, points, scene, segment, measured),
    )
    return kind, taught


def _meant(asked: Teaching, scene: Scene, T_frame_camera: NDArray[np.float64]) -> Segment:
    """The segment at the place asked for, or the only one."""
    if not scene.supports:
        raise UsageError("no surface was seen that a thing could stand on: put it on a table or on the floor")
    if asked.place is None:
        things = [segment for segment in scene.segments if segment.support == 0]
        if len(things) == 1:
            return things[0]
        raise UsageError(f"{_named(things, T_frame_camera)}; expected one: say which with its place (--at)")
    place = transform_xyz(inverse(T_frame_camera), np.array(asked.place))
    gaps = [_gap(place, segment) for segment in scene.segments]
    if not gaps or min(gaps) > NEAR:
        where = "({:.3f}, {:.3f}, {:.3f})".format(*asked.place)
        raise UsageError(f"nothing is at {where}: {_named(scene.segments, T_frame_camera)}")
    return scene.segments[int(np.argmin(gaps))]


def _gap(place: NDArray[np.floating], segment: Segment) -> float:
    """Metres from a place (3,), cloud frame, to the box around a segment."""
    inside = np.abs(transform_xyz(inverse(segment.T_camera_box), place)) - segment.size / 2
    return float(np.linalg.norm(np.maximum(inside, 0)))


def _named(things: list[Segment], T_frame_camera: NDArray[np.float64]) -> str:
    """How many things there are, and where."""
    places = [transform_xyz(T_frame_camera, thing.centroid) for thing in things]
    told = ", ".join("({:.3f}, {:.3f}, {:.3f})".format(*place) for place in places)
    return f"{len(things)} things stand there" + (f", at {told}" if told else "")


def _shape_of(shape: Shape) -> ShapeOf:
    match shape:
        case Box(size):
            length, width, height = (round(edge, _DIGITS) for edge in size)
            return ShapeOf(box=BoxShape(size=(length, width, height)))
        case Cylinder(diameter, height):
            return ShapeOf(cylinder=CylinderShape(diameter=round(diameter, _DIGITS), height=round(height, _DIGITS)))
        case Sphere(diameter):
            return ShapeOf(sphere=SphereShape(diameter=round(diameter, _DIGITS)))
        case _:
            raise UsageError(f"a {type(shape).__name__} cannot be taught; expected one of {', '.join(SHAPES)}")


def _colour_of(points: Points, scene: Scene, segment: Segment) -> tuple[int, int, int] | None:
    """Median colour of a segment, where the cloud has colours."""
    if not has_colour(points):
        return None
    red, green, blue = (int(c) for c in np.median(colours(points)[scene.labels == segment.label], axis=0))
    return red, green, blue


def _picture_of(name: str, points: Points, scene: Scene, segment: Segment, measured: Measurement) -> bytes:
    """The measured shape drawn over the cloud, from a little above where the camera is."""
    size = " x ".join(f"{1e3 * edge:.1f}" for edge in _edges(measured.shape))
    drawings: list[picture.Drawing] = [
        picture.Outline(measured.shape, measured.T_camera_model, label=name),
        picture.Triad(measured.T_camera_model, length=float(np.clip(0.6 * max(segment.size), 0.05, 0.15))),
        picture.Legend((f"{type(measured.shape).__name__.lower()}\t{size} mm", f"explained\t{measured.explained:.0%}")),
    ]
    eye = picture.eye_around(segment.T_camera_box[:3, 3], scene.supports[segment.support].normal, 0.6)
    return picture.png_of(picture.draw(points, drawings, eye, _PICTURE))


def _edges(shape: Shape) -> tuple[float, ...]:
    match shape:
        case Box(size):
            return size
        case Cylinder(diameter, height):
            return diameter, height
        case Sphere(diameter):
            return (diameter,)
        case _:
            return ()
