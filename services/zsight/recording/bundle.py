"""The smallest file that reproduces one answer: its cloud, transforms, catalogue, goal, result and settings."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from zsight.errors import UsageError
from zsight.recording.answers import answers
from zsight.recording.conversion import as_sample
from zsight.recording.opening import open_recording
from zsight.recording.recording_file import RecordingFile

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["bundle"]


def bundle(source: Path, target: Path, goal_id: str = "", namespace: str = "zsight") -> dict[str, Any]:
    """Write the last answer of a recording, or that to one goal, as a recording of its own.

    Args:
        source: a recording with goals, answers and clouds.
        target: the new file.
        goal_id: of the answer; the last one's if not given.
        namespace: of the keys.

    Raises:
        UsageError: there is no such answer, or the target is there already.
    """
    recording = open_recording(source)
    try:
        wanted = (answer for answer in answers(recording) if goal_id in ("", answer.goal.goal_id))
        last = deque(wanted, maxlen=1)
        if not last:
            what = f"the answer to goal {goal_id}" if goal_id else "an answer"
            raise UsageError(f"{source} does not hold {what} with its goal and its cloud: record all keys of the cell")
        answer = last[0]
        about = {"bundle": answer.goal.goal_id, "finder": answer.finder}
        file = RecordingFile(target, namespace, about)
        try:
            for sequence, part in enumerate(answer.parts, 1):
                file.write(as_sample(part, namespace, sequence))
            file.finish("zstd", whole=True)
        except BaseException:
            target.unlink(missing_ok=True)
            raise
    finally:
        recording.close()
    return {
        "file": str(target),
        "size": target.stat().st_size,
        "goal_id": answer.goal.goal_id,
        "object_type": answer.goal.object_type,
        "status": answer.result.status.value,
        "messages": len(answer.parts),
    }
