"""Messages to arrays and back: the only place where the protocol and the core meet."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.errors import UsageError
from zsight_core import transform
from zsight_protocol.geometry import Point, Pose, Quaternion, Transform, TransformStamped, Vector3
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import Datatype, PointCloud2, PointField
from zsight_protocol.recent import Recent

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_protocol.point_cloud import Buffer

__all__ = ["cloud_from_points", "matrix_of", "point", "points_of", "pose_of", "stamped", "vector"]

_FORMATS = {
    Datatype.INT8: "i1",
    Datatype.UINT8: "u1",
    Datatype.INT16: "<i2",
    Datatype.UINT16: "<u2",
    Datatype.INT32: "<i4",
    Datatype.UINT32: "<u4",
    Datatype.FLOAT32: "<f4",
    Datatype.FLOAT64: "<f8",
}
_AT_ONCE = 8192  # points that are looked at in one go
_layouts: Recent[tuple[np.dtype[Any], tuple[int, int], str], PointCloud2] = Recent()  # legal, without their points
_DATATYPES = {np.dtype(form): datatype for datatype, form in _FORMATS.items()}


def points_of(cloud: PointCloud2) -> Points:
    """The points of a message, shape (height, width): a read-only view of its data, nothing is copied."""
    points: Points = np.frombuffer(cloud.data, dtype=_dtype_of(cloud.fields, cloud.point_step))
    return points.reshape(cloud.height, cloud.width)


@lru_cache(maxsize=64)
def _dtype_of(fields: tuple[PointField, ...], point_step: int) -> np.dtype[np.void]:
    formats: list[Any] = [
        _FORMATS[field.datatype] if field.count == 1 else (_FORMATS[field.datatype], field.count) for field in fields
    ]
    return np.dtype(
        {
            "names": [field.name for field in fields],
            "formats": formats,
            "offsets": [field.offset for field in fields],
            "itemsize": point_step,
        }
    )


def cloud_from_points(points: Points, stamp: Time, frame_id: str, *, is_dense: bool | None = None) -> PointCloud2:
    """A message of points (H, W); its data is a view of theirs where they lie side by side, else a copy.

    Args:
        points: (H, W); metres.
        stamp: when they were measured.
        frame_id: frame that they are in.
        is_dense: true where none of them is NaN; looked for where it is not given.

    Raises:
        UsageError: there are no points, or a field is of a type that PointCloud2 has no code for.
    """
    if points.size == 0:
        raise UsageError("the cloud has no points; expected at least one: nothing can be published")
    packed = points if points.flags.c_contiguous else _side_by_side(points)
    known = _layouts.get((packed.dtype, packed.shape, frame_id)) or _remembered(packed, frame_id)
    return known.but(
        header=known.header.but(stamp=stamp),
        is_dense=_is_dense(packed) if is_dense is None else is_dense,
        data=_bytes_of(packed),
    )


def _remembered(points: Points, frame_id: str) -> PointCloud2:
    """A legal cloud in place of these points; the points themselves are not kept."""
    height, width = points.shape
    step = points.dtype.itemsize
    cloud = PointCloud2(
        header=Header(stamp=Time(), frame_id=frame_id),
        height=height,
        width=width,
        fields=_fields_of(points.dtype),
        is_bigendian=False,
        point_step=step,
        row_step=width * step,
        is_dense=False,
        data=_bytes_of(points),
    ).but(data=b"")
    return _layouts.keep((points.dtype, points.shape, frame_id), cloud)


def _bytes_of(points: Points) -> Buffer:
    """A view of the points; where they fill a bytes object that one, which the bus copies faster."""
    owner: Any = points
    while isinstance(owner, np.ndarray):
        owner = owner.base
    return owner if isinstance(owner, bytes) and len(owner) == points.nbytes else np.frombuffer(points, np.uint8).data


def _side_by_side(points: Points) -> Points:
    """A copy without strides; the gaps between its fields are zeros, not what was in memory before."""
    packed = np.zeros(points.shape, points.dtype)
    for name in points.dtype.names or ():
        packed[name] = points[name]
    return packed


def _fields_of(dtype: np.dtype[Any]) -> tuple[PointField, ...]:
    entries: dict[str, Any] = dict(dtype.fields or {})
    return tuple(_field(name, entry[0], entry[1]) for name, entry in entries.items())


def _field(name: str, dtype: np.dtype[Any], offset: int) -> PointField:
    base, count = dtype.base, int(np.prod(dtype.shape, dtype=np.int64))
    if base not in _DATATYPES:
        expected = ", ".join(datatype.name.lower() for datatype in Datatype)
        raise UsageError(f"field {name} is {base}; PointCloud2 knows {expected}: convert it first")
    return PointField(name=name, offset=offset, datatype=_DATATYPES[base], count=count)


def _is_dense(points: Points) -> bool:
    """The corner, then row by row: depth cameras mostly see a hole there, and then the rest is not looked at."""
    axes = [axis for axis in "xyz" if axis in (points.dtype.names or ())]
    for axis in axes:
        if math.isnan(points[axis].item(0)):
            return False
    rows, step = len(points), max(1, _AT_ONCE // max(points.shape[1], 1))
    return not any(np.isnan(points[axis][row : row + step]).any() for row in range(0, rows, step) for axis in axes)


def matrix_of(pose: Pose | Transform) -> NDArray[np.float64]:
    """T (4, 4) of a pose or a transform."""
    place = pose.position if isinstance(pose, Pose) else pose.translation
    turn = pose.orientation if isinstance(pose, Pose) else pose.rotation
    return transform.from_quaternion([place.x, place.y, place.z], [turn.x, turn.y, turn.z, turn.w])


def pose_of(T: NDArray[np.float64]) -> Pose:
    """The pose of a matrix (4, 4)."""
    return Pose(position=point(T[:3, 3]), orientation=_quaternion(T))


def stamped(T_parent_child: NDArray[np.float64], parent: str, child: str, stamp: Time) -> TransformStamped:
    """A transform message of a matrix (4, 4)."""
    return TransformStamped(
        header=Header(stamp=stamp, frame_id=parent),
        child_frame_id=child,
        transform=Transform(translation=vector(T_parent_child[:3, 3]), rotation=_quaternion(T_parent_child)),
    )


def point(values: Sequence[float] | NDArray[np.floating]) -> Point:
    """A point message of three numbers."""
    x, y, z = (float(value) for value in values)
    return Point(x=x, y=y, z=z)


def vector(values: Sequence[float] | NDArray[np.floating]) -> Vector3:
    """A vector message of three numbers."""
    x, y, z = (float(value) for value in values)
    return Vector3(x=x, y=y, z=z)


def _quaternion(T: NDArray[np.float64]) -> Quaternion:
    x, y, z, w = (float(value) for value in transform.quaternion(T))
    return Quaternion(x=x, y=y, z=z, w=w)
