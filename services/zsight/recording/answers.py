"""The answers in a recording, each with all that it was made of: goal, cloud, transforms, catalogue."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zsight.transforms import TransformBuffer
from zsight_protocol.action import Update
from zsight_protocol.channels import Delivery
from zsight_protocol.find_object import FindObjectGoal, FindObjectResult
from zsight_protocol.geometry import TransformList
from zsight_protocol.object_type import CatalogAnswer
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight.recording.played import Line, Played, Recorded

__all__ = ["Answer", "answers"]

_BEFORE_NS = 60_000_000_000  # a cloud that was searched came at most so long before its answer
_TRANSFORMS_NS = 500_000_000  # moving transforms that belong to a cloud: so long around it


@dataclass(frozen=True)
class Answer:
    """One answer: ``parts`` are the messages that it was made of and itself, in the order of the recording."""

    finder: str
    goal: FindObjectGoal
    result: FindObjectResult
    cloud: PointCloud2
    parts: tuple[Played, ...]

    def transforms(self) -> TransformBuffer:
        """Where every frame was when the cloud was measured."""
        buffer = TransformBuffer()
        for part in self.parts:
            message = part.load() if part.line.key in ("tf", "tf_static") else None
            if isinstance(message, TransformList):
                buffer.put(message, static=part.line.key == "tf_static")
        return buffer

    def catalogue(self) -> CatalogAnswer | None:
        """The types that the finder knew, where that was recorded."""
        for part in self.parts:
            if part.line.kind is CatalogAnswer:
                message = part.load()
                return message if isinstance(message, CatalogAnswer) else None
        return None


def answers(recording: Recorded) -> Iterator[Answer]:
    """Every answer whose goal and cloud are in the recording, in order; a refused goal has no cloud and is left out."""
    lines = [line for line in recording.lines if re.fullmatch(r"find_object/[^/]+/(goal|feedback)", line.key)]
    goals: dict[str, tuple[Played, FindObjectGoal]] = {}
    for played in recording.messages(recording.start_ns, None, lines):
        message = played.load()
        if isinstance(message, FindObjectGoal):
            goals[message.goal_id] = played, message
        elif isinstance(message, Update) and message.final and message.goal_id in goals:
            answer = _answer(recording, goals[message.goal_id], played, message.result)
            if answer is not None:
                yield answer


def _answer(recording: Recorded, goal: tuple[Played, FindObjectGoal], ended: Played, result: object) -> Answer | None:
    if not isinstance(result, FindObjectResult):
        return None
    finder = ended.line.key.split("/")[1]
    camera = goal[1].camera or str(result.report.get("camera", ""))
    found = _cloud(recording, camera, result.header.stamp.ns, ended.log_time)
    if found is None:
        return None
    played, cloud = found
    around = _around(recording, finder, camera, played.log_time, ended.log_time)
    parts = sorted([*around, played, goal[0], ended], key=lambda part: part.log_time)
    return Answer(finder, goal[1], result, cloud, tuple(parts))


def _cloud(recording: Recorded, camera: str, stamp_ns: int, before: int) -> tuple[Played, PointCloud2] | None:
    """The cloud of a camera with this stamp; of any camera where none is named."""
    wanted = [
        line
        for line in recording.lines
        if line.kind is PointCloud2 and re.fullmatch(rf"{re.escape(camera) or '[^/]+'}/points", line.key)
    ]
    for played in recording.messages(before - _BEFORE_NS, before + 1, wanted):
        cloud = played.load()
        if isinstance(cloud, PointCloud2) and cloud.header.stamp.ns == stamp_ns:
            return played, cloud
    return None


def _around(recording: Recorded, finder: str, camera: str, cloud_ns: int, end: int) -> list[Played]:
    """Everything else that held: latched values, moving transforms around the cloud, the finder's last word."""
    latched = [line for line in recording.lines if line.delivery is Delivery.LATCHED and _matters(line, finder, camera)]
    held = [recording.last_before(end, [line]) for line in latched]
    moving = [line for line in recording.lines if line.key == "tf"]
    transforms = recording.messages(cloud_ns - _TRANSFORMS_NS, min(cloud_ns + _TRANSFORMS_NS, end), moving)
    beats = [line for line in recording.lines if re.fullmatch(rf"@health/[^/]+/{re.escape(finder)}", line.key)]
    beat = recording.last_before(end, beats) if beats else None
    return [*(played for played in (*held, beat) if played is not None), *transforms]


def _matters(line: Line, finder: str, camera: str) -> bool:
    return line.key in ("tf_static", f"{camera}/camera_info", f"find_object/{finder}/catalogue")
