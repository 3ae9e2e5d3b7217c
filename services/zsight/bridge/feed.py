"""What a bridge takes from the bus: the newest clouds of all cameras, all transforms, the answers of all finders."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol

from zsight.catalogue import type_files
from zsight.things import Thing, things_of
from zsight_protocol.action import Update
from zsight_protocol.channels import Delivery
from zsight_protocol.find_object import FindObjectResult, ResultCode
from zsight_protocol.geometry import TransformList
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from zsight.bus import Bus, Reader

__all__ = ["Sink", "feed"]

_ROUND = 0.02  # seconds between two looks at what is new
_AGAIN = 1.0  # seconds after which what still holds is sent again, for viewers that have just come


class Sink(Protocol):
    """The other viewer."""

    def cloud(self, camera: str, cloud: PointCloud2) -> None:
        """The newest cloud of a camera."""

    def transforms(self, transforms: TransformList, *, static: bool) -> None:
        """Where frames are."""

    def things(self, things: list[Thing]) -> None:
        """All that is found, in place of what was found before."""

    def again(self) -> None:
        """Once a second: send what still holds to whoever has just come."""

    def close(self) -> None:
        """No more comes."""


def feed(bus: Bus, sink: Sink) -> None:
    """Hand on to a viewer until the bus stops; a viewer that is slow misses clouds and slows nobody."""
    kind: type[Update[FindObjectResult]] = Update[FindObjectResult]
    clouds = bus.reader(f"{bus.cell.namespace}/*/points", PointCloud2, delivery=Delivery.LATEST)
    transforms = {
        static: bus.reader(key, TransformList) for static, key in ((True, bus.cell.tf_static), (False, bus.cell.tf))
    }
    answers = _Answers(bus.reader(bus.cell.feedback("*"), kind, delivery=Delivery.EVERY))
    bus.ready()
    next_time = time.monotonic() + _AGAIN
    while not bus.stopping.wait(_ROUND):
        for static, reader in transforms.items():
            while (moved := reader.take(0)) is not None:
                sink.transforms(moved.message, static=static)
        while (received := clouds.take(0)) is not None:
            sink.cloud(received.key.removeprefix(f"{bus.cell.namespace}/").split("/")[0], received.message)
        if answers.take():
            sink.things(answers.things())
        if time.monotonic() >= next_time:
            next_time = time.monotonic() + _AGAIN
            sink.again()
    sink.close()


class _Answers:
    """The last answer to each question."""

    def __init__(self, reader: Reader[Update[FindObjectResult]]) -> None:
        self._reader = reader
        self._catalogue = type_files.load(type_files.shipped_folder())
        self._found: dict[str, list[Thing]] = {}

    def take(self) -> bool:
        """Take in what was answered; whether that was anything."""
        changed = False
        while (received := self._reader.take(0)) is not None:
            result = received.message.result
            if result is not None and result.code in (ResultCode.FOUND, ResultCode.NOT_FOUND):
                asked = str(result.report.get("object_type") or "object")
                self._found[asked] = things_of(asked, result, self._catalogue)
                changed = True
        return changed

    def things(self) -> list[Thing]:
        return [thing for things in self._found.values() for thing in things]
