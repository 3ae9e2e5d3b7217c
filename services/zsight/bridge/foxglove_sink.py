"""To Foxglove: a WebSocket server of its protocol, which its app and every other client of it connects to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import foxglove
from foxglove import channels, messages
from foxglove.messages import PackedElementFieldNumericType as Kind

from zsight.errors import UsageError
from zsight_core.transform import quaternion
from zsight_protocol.point_cloud import Datatype

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from zsight.things import Thing
    from zsight_protocol.geometry import TransformList
    from zsight_protocol.message import Time
    from zsight_protocol.point_cloud import PointCloud2

__all__ = ["FoxgloveSink"]

_BACKLOG = 16  # messages that wait for a slow client, which then misses the oldest: clouds are large
_COLOURS = (("blue", 0), ("green", 1), ("red", 2))  # bytes of a packed colour, 0x00RRGGBB little-endian
_KINDS = {
    Datatype.INT8: Kind.Int8,
    Datatype.UINT8: Kind.Uint8,
    Datatype.INT16: Kind.Int16,
    Datatype.UINT16: Kind.Uint16,
    Datatype.INT32: Kind.Int32,
    Datatype.UINT32: Kind.Uint32,
    Datatype.FLOAT32: Kind.Float32,
    Datatype.FLOAT64: Kind.Float64,
}


class FoxgloveSink:
    """A server; clouds go out byte for byte as they came."""

    def __init__(self, host: str, port: int) -> None:
        """Serve.

        Args:
            host: address that is listened on.
            port: 0 takes any that is free.

        Raises:
            UsageError: the port is taken, or the address is not this host's.
        """
        self._context = foxglove.Context()
        self._transforms = channels.FrameTransformsChannel("/tf", context=self._context)
        self._scene = channels.SceneUpdateChannel("/found", context=self._context)
        self._clouds: dict[str, channels.PointCloudChannel] = {}
        self._static: dict[str, messages.FrameTransform] = {}
        self._things: list[Thing] = []
        try:
            self._server = foxglove.start_server(
                name="zsight", host=host, port=port, context=self._context, message_backlog_size=_BACKLOG
            )
        except (OSError, RuntimeError) as error:
            raise UsageError(f"cannot serve Foxglove on {host}:{port} ({error}): give another --port") from None
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"

    def cloud(self, camera: str, cloud: PointCloud2) -> None:
        """The newest cloud of a camera."""
        if camera not in self._clouds:
            self._clouds[camera] = channels.PointCloudChannel(f"/{camera}/points", context=self._context)
        message = messages.PointCloud(
            timestamp=_timestamp(cloud.header.stamp),
            frame_id=cloud.header.frame_id,
            pose=messages.Pose(position=messages.Vector3(), orientation=messages.Quaternion(w=1.0)),
            point_stride=cloud.point_step,
            fields=_fields(cloud),
            data=bytes(cloud.data),
        )
        self._clouds[camera].log(message, log_time=cloud.header.stamp.ns)

    def transforms(self, transforms: TransformList, *, static: bool) -> None:
        """Where frames are."""
        moved = {}
        for entry in transforms.transforms:
            t, r = entry.transform.translation, entry.transform.rotation
            moved[entry.child_frame_id] = messages.FrameTransform(
                timestamp=_timestamp(entry.header.stamp),
                parent_frame_id=entry.header.frame_id,
                child_frame_id=entry.child_frame_id,
                translation=messages.Vector3(x=t.x, y=t.y, z=t.z),
                rotation=messages.Quaternion(x=r.x, y=r.y, z=r.z, w=r.w),
            )
        if static:
            self._static |= moved
        self._transforms.log(messages.FrameTransforms(transforms=list(moved.values())))

    def things(self, things: list[Thing]) -> None:
        """All that is found, in place of what was found before."""
        self._things = things
        gone = messages.SceneEntityDeletion(type=messages.SceneEntityDeletionType.All)
        self._scene.log(messages.SceneUpdate(deletions=[gone], entities=[_entity(thing) for thing in things]))

    def again(self) -> None:
        """Clients are sent only what comes after them: tell once more where things and frames are."""
        if self._static:
            self._transforms.log(messages.FrameTransforms(transforms=list(self._static.values())))
        if self._things:
            self.things(self._things)

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()


def _timestamp(stamp: Time) -> messages.Timestamp:
    return messages.Timestamp(stamp.sec, stamp.nanosec)


def _fields(cloud: PointCloud2) -> list[messages.PackedElementField]:
    """The fields as they lie there; a packed colour as its three bytes, which every viewer takes for a colour."""
    found = []
    for field in cloud.fields:
        if field.name == "rgb":
            found += [_field(name, field.offset + byte, Kind.Uint8) for name, byte in _COLOURS]
        else:
            size = Datatype(field.datatype).size
            names = [field.name] if field.count == 1 else [f"{field.name}_{i}" for i in range(field.count)]
            found += [_field(name, field.offset + i * size, _KINDS[field.datatype]) for i, name in enumerate(names)]
    return found


def _field(name: str, offset: int, kind: Kind) -> messages.PackedElementField:
    return messages.PackedElementField(name=name, offset=offset, type=kind)


def _entity(thing: Thing) -> messages.SceneEntity:
    pose, size = _pose(thing.T_frame_thing), float(abs(thing.vertices).max())
    r, g, b = (channel / 255 for channel in thing.colour)
    corners = [messages.Point3(x=x, y=y, z=z) for x, y, z in thing.vertices.tolist()]
    shape = messages.TriangleListPrimitive(
        pose=pose, points=corners, color=messages.Color(r=r, g=g, b=b, a=0.55), indices=thing.faces.ravel().tolist()
    )
    lifted = thing.T_frame_thing.copy()
    lifted[:3, 3] += lifted[:3, 2] * (size + 0.02)
    label = messages.TextPrimitive(
        pose=_pose(lifted),
        billboard=True,
        font_size=14.0,
        scale_invariant=True,
        color=messages.Color(r=0.9, g=0.9, b=0.9, a=1.0),
        text=thing.words,
    )
    return messages.SceneEntity(
        timestamp=_timestamp(thing.stamp), frame_id=thing.frame_id, id=thing.name, triangles=[shape], texts=[label]
    )


def _pose(T: NDArray[np.float64]) -> messages.Pose:
    x, y, z, w = (float(value) for value in quaternion(T))
    px, py, pz = (float(value) for value in T[:3, 3])
    return messages.Pose(
        position=messages.Vector3(x=px, y=py, z=pz), orientation=messages.Quaternion(x=x, y=y, z=z, w=w)
    )
