"""Recordings made on a network in memory, for the tests of recorder and player."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np
from tests.services.waiting import Arrivals

from zsight.bus.attachment import Attachment
from zsight.convert import cloud_from_points
from zsight.recording.mcap_file import McapFile
from zsight.recording.sample import Sample
from zsight_core.points import from_xyz
from zsight_protocol.channels import Delivery
from zsight_protocol.codec import encode
from zsight_protocol.geometry import Quaternion, Transform, TransformList, TransformStamped, Vector3
from zsight_protocol.message import Header, Message, Time

if TYPE_CHECKING:
    from pathlib import Path

    from zsight.bus import Bus
    from zsight_protocol.point_cloud import PointCloud2

__all__ = ["START", "cloud", "damage", "follow", "sample", "transform"]

START = 1_700_000_000 * 10**9
"""When made-up recordings begin, ns since the epoch."""


def cloud(number: int, *, size: tuple[int, int] = (4, 5), stamp_ns: int | None = None) -> PointCloud2:
    """A cloud that tells its number in every coordinate, with colours."""
    rng = np.random.default_rng(number)
    points = from_xyz(np.full((*size, 3), number), rng.integers(0, 256, (*size, 3)))
    return cloud_from_points(points, Time.from_ns(START + number if stamp_ns is None else stamp_ns), "eye")


def transform(x: float, *, stamp_ns: int = START, child: str = "eye") -> TransformList:
    """A transform from the world to the camera."""
    place = Transform(translation=Vector3(x=x), rotation=Quaternion())
    header = Header(stamp=Time.from_ns(stamp_ns), frame_id="world")
    return TransformList(transforms=(TransformStamped(header=header, child_frame_id=child, transform=place),))


def sample(key: str, message: Message | bytes, at_ns: int, *, sequence: int = 1, writer: int = 7) -> Sample:
    """A message as the recorder gets it."""
    payload = message if isinstance(message, bytes) else encode(message)
    return Sample(key, payload, Attachment(writer, sequence, at_ns - 1000), at_ns)


def damage(path: Path, chunk: int, target: Path) -> Path:
    """The same file with one bit changed in the middle of a chunk, and its index as it was."""
    content = bytearray(path.read_bytes())
    with McapFile.open(path) as file:
        wanted = file.chunks[chunk]
    content[wanted.offset + wanted.length // 2] ^= 1
    target.write_bytes(content)
    return target


def follow(bus: Bus, *keys: str) -> Arrivals[tuple[str, bytes]]:
    """Every message of some keys as bytes, in the order in which they come."""
    arrivals: Arrivals[tuple[str, bytes]] = Arrivals()
    lock = threading.Lock()

    def arrived(raw: object) -> None:
        with lock:
            arrivals.add((raw.key, raw.take() or b""))  # type: ignore[attr-defined]  # a RawSample

    for key in keys:
        bus.link.reader(key, Delivery.EVERY, arrived)
    return arrivals
