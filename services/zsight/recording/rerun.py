"""Every recorded goal once more against its own cloud, with today's code: what has changed."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.convert import matrix_of, points_of
from zsight.errors import ZsightError
from zsight.finding import answering
from zsight.recording.answers import answers
from zsight.recording.opening import open_recording
from zsight_core import find as find_core
from zsight_core import scene as scene_core
from zsight_core.errors import CoreError
from zsight_core.scene_limits import SceneLimits
from zsight_core.transform import angle_between

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.catalogue.type_files import Catalogue
    from zsight.recording.answers import Answer
    from zsight_protocol.find_object import DetectedObject, FindObjectResult

__all__ = ["Tolerance", "compare", "rerun"]

_SAME = 0.05  # metres; an answer further off is another object


@dataclass(frozen=True)
class Tolerance:
    """What may change without being a regression: millimetres, degrees."""

    position: float = 5.0
    rotation: float = 5.0


def rerun(
    path: Path,
    catalogue: Catalogue,
    *,
    tolerance: Tolerance | None = None,
    limits: SceneLimits | None = None,
    say: Callable[[dict[str, Any], float], object] = lambda _row, _share: None,
) -> list[dict[str, Any]]:
    """Search every recorded cloud again for what it was searched for.

    Args:
        path: a recording.
        catalogue: today's; types that were known then and are not now are taken from the recording.
        tolerance: what may change.
        limits: what counts as a thing, where it is to be tried with others than the usual ones.
        say: told each entry as soon as it is there, and which share of the recording is done.

    Returns:
        One entry a goal: what was found then and now, the largest differences, and ``regression`` in words or empty.

    Raises:
        UsageError: the recording cannot be read.
    """
    find_core.warm_up()
    scene_core.warm_up()
    recording = open_recording(path)
    rows: list[dict[str, Any]] = []
    length = max(recording.end_ns - recording.start_ns, 1)
    try:
        for answer in answers(recording):
            rows.append(_row(answer, catalogue, tolerance or Tolerance(), limits or SceneLimits()))
            say(rows[-1], (answer.parts[-1].log_time - recording.start_ns) / length)
    finally:
        recording.close()
    return rows


def _row(answer: Answer, catalogue: Catalogue, tolerance: Tolerance, limits: SceneLimits) -> dict[str, Any]:
    _add_recorded_types(answer, catalogue)
    begun = time.perf_counter()
    try:
        now, words = _find_again(answer, catalogue, limits), ""
    except (ZsightError, CoreError) as error:
        now, words = None, str(error)
    row: dict[str, Any] = {
        "goal_id": answer.goal.goal_id,
        "object_type": answer.goal.object_type,
        "stamp_ns": answer.cloud.header.stamp.ns,
        "ms_then": answer.result.timings_ms.get("in_finder"),
        "ms_now": (time.perf_counter() - begun) * 1e3,
    }
    if now is None:
        return {**row, "then": answer.result.status.value, "now": "error", "regression": words}
    return {**row, **compare(answer.result, now, tolerance)}


def _add_recorded_types(answer: Answer, catalogue: Catalogue) -> None:
    recorded = answer.catalogue()
    for kind in () if recorded is None else recorded.types:
        if kind.name not in catalogue.types and kind.shape.mesh is None:
            catalogue.add(kind, Path())


def _find_again(answer: Answer, catalogue: Catalogue, limits: SceneLimits) -> FindObjectResult:
    """What the finder does with a goal, without a network and without a deadline."""
    goal, cloud = answer.goal, answer.cloud
    buffer, camera, stamp = answer.transforms(), cloud.header.frame_id, cloud.header.stamp.ns
    frame, root = answer.result.header.frame_id, buffer.root_of(camera)
    T_frame_camera = buffer.lookup(frame, camera, stamp)
    gravity = None if root == camera else buffer.lookup(root, camera, stamp)
    points = points_of(cloud)
    known_height = answering.height_in_world(goal.known_height, frame, T_frame_camera, gravity)
    scene = scene_core.understand(points, T_world_camera=gravity, known_height=known_height, limits=limits)
    found = answering.find(
        points,
        catalogue,
        catalogue.wanted(goal.object_type),
        scene=scene,
        T_frame_camera=T_frame_camera,
        region=goal.region,
        maximum=goal.maximum,
        checkpoint=lambda _stage, _fraction: None,
    )
    return answering.result_of(
        found, catalogue, scene=scene, T_frame_camera=T_frame_camera, stamp=cloud.header.stamp, frame_id=frame
    )


def compare(then: FindObjectResult, now: FindObjectResult, tolerance: Tolerance) -> dict[str, Any]:
    """How an answer differs from that of before.

    A regression is an object that is found no more, or elsewhere by more than the tolerance. That something is found
    where nothing was before is a change, and for people to judge.
    """
    left = list(now.objects)
    moved_mm, turned_deg, score_change, lost = 0.0, 0.0, 0.0, 0
    for before in then.objects:
        after = min(left, key=lambda found: _distance(before, found), default=None)
        if after is None or _distance(before, after) > _SAME:
            lost += 1
            continue
        left.remove(after)
        moved_mm = max(moved_mm, 1e3 * _distance(before, after))
        turned_deg = max(turned_deg, _angle(before, after))
        score_change = min(score_change, after.score - before.score, key=lambda change: -abs(change))
    words = [
        f"{lost} of {len(then.objects)} are found no more" if lost else "",
        f"{moved_mm:.1f} mm elsewhere" if moved_mm > tolerance.position else "",
        f"turned by {turned_deg:.1f} degrees" if turned_deg > tolerance.rotation else "",
    ]
    return {
        "then": then.status.value,
        "now": now.status.value,
        "found_then": len(then.objects),
        "found_now": len(now.objects),
        "lost": lost,
        "new": len(left),
        "segments_then": then.report.get("segments"),
        "segments_now": now.report.get("segments"),
        "moved_mm": moved_mm,
        "turned_deg": turned_deg,
        "score_change": score_change,
        "regression": ", ".join(word for word in words if word),
    }


def _distance(a: DetectedObject, b: DetectedObject) -> float:
    one, two = matrix_of(a.pose), matrix_of(b.pose)
    return float(np.linalg.norm(one[:3, 3] - two[:3, 3]))


def _angle(before: DetectedObject, after: DetectedObject) -> float:
    """Degrees between two poses; poses that look the same count as one."""
    poses = (before.pose, *before.equivalent_poses)
    T_after = matrix_of(after.pose)
    return min(float(np.degrees(angle_between(matrix_of(pose), T_after))) for pose in poses)
