"""To Rerun: its viewer, wherever it is, or a file that it opens."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun

from zsight.convert import points_of
from zsight_core.errors import CoreError
from zsight_core.points import colours, has_colour
from zsight_core.thin import thin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight.things import Thing
    from zsight_protocol.geometry import TransformList
    from zsight_protocol.message import Time
    from zsight_protocol.point_cloud import PointCloud2

__all__ = ["RerunSink"]

_TIMELINE = "stamp"
_DISC = 0.003  # metres; radius of a point


class RerunSink:
    """A recording that goes there while it is made; times are the stamps of the messages."""

    def __init__(self, target: str, budget: int) -> None:
        """Args: address of a viewer (rerun+http://HOST:PORT/proxy) or a .rrd file; points of a cloud at most."""
        self._budget = budget
        self._stream = rerun.RecordingStream("zsight")
        self._drawn: set[str] = set()
        if target.endswith(".rrd"):
            self._stream.save(target)
        else:
            self._stream.connect_grpc(target)

    def cloud(self, camera: str, cloud: PointCloud2) -> None:
        """The newest cloud of a camera."""
        try:
            points, xyz = thin(points_of(cloud), self._budget)
        except CoreError:
            return
        self._at(cloud.header.stamp)
        shown = rerun.Points3D(xyz, colors=colours(points) if has_colour(points) else None, radii=_DISC)
        self._stream.log(f"clouds/{camera}", shown, rerun.CoordinateFrame(cloud.header.frame_id))

    def transforms(self, transforms: TransformList, *, static: bool) -> None:
        """Where frames are."""
        for entry in transforms.transforms:
            t, r = entry.transform.translation, entry.transform.rotation
            self._at(entry.header.stamp)
            placed = rerun.Transform3D(
                translation=(t.x, t.y, t.z),
                quaternion=rerun.Quaternion(xyzw=(r.x, r.y, r.z, r.w)),
                parent_frame=entry.header.frame_id,
                child_frame=entry.child_frame_id,
            )
            self._stream.log(f"frames/{entry.child_frame_id}", placed, static=static)

    def things(self, things: list[Thing]) -> None:
        """All that is found, in place of what was found before."""
        now = {f"found/{thing.name}" for thing in things}
        for gone in self._drawn - now:
            self._stream.log(gone, rerun.Clear(recursive=True))
        self._drawn = now
        for thing in things:
            self._at(thing.stamp)
            shape = rerun.Mesh3D(
                vertex_positions=_placed(thing.vertices, thing.T_frame_thing),
                triangle_indices=thing.faces,
                albedo_factor=(*thing.colour, 140),
            )
            node = f"found/{thing.name}"
            self._stream.log(node, shape, rerun.CoordinateFrame(thing.frame_id))
            axes = thing.T_frame_thing[:3, :3].T * float(np.ptp(thing.vertices, axis=0).max()) * 0.6
            arrows = rerun.Arrows3D(
                origins=np.repeat(thing.T_frame_thing[np.newaxis, :3, 3], 3, axis=0),
                vectors=axes,
                colors=np.eye(3, dtype=np.uint8) * 255,
                labels=[thing.words, "", ""],
            )
            self._stream.log(f"{node}/axes", arrows, rerun.CoordinateFrame(thing.frame_id))

    def again(self) -> None:
        """Rerun keeps what it was sent."""

    def close(self) -> None:
        """Write what is left."""
        self._stream.disconnect()

    def _at(self, stamp: Time) -> None:
        self._stream.set_time(_TIMELINE, timestamp=np.datetime64(stamp.ns, "ns"))


def _placed(points: NDArray[np.float64], T: NDArray[np.float64]) -> NDArray[np.float64]:
    placed: NDArray[np.float64] = points @ T[:3, :3].T + T[:3, 3]
    return placed
