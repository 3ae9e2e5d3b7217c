"""What was in force at a moment of a recording: what a program that had listened from the beginning would know."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zsight_protocol.channels import Delivery

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zsight.recording.played import Line, Played, Recorded

__all__ = ["in_force"]

_TRANSFORMS_NS = 2_000_000_000  # moving transforms that are given again: so long before the oldest cloud


def in_force(recording: Recorded, lines: Sequence[Line], time: int) -> list[Played]:
    """The messages that hold at a time (ns), in the order in which they were sent.

    Of what is latched the last of each writer; of what only the newest matters, the last of each key; and the moving
    transforms since shortly before the oldest of those, by which it can be placed.
    """
    latched = [line for line in lines if line.delivery is Delivery.LATCHED]
    latest = [line for line in lines if line.delivery is Delivery.LATEST]
    moving = [line for line in lines if line.key == "tf"]
    by_key: dict[str, list[Line]] = {}
    for line in latest:
        by_key.setdefault(line.key, []).append(line)
    held = [recording.last_before(time, [line]) for line in latched]
    newest = [recording.last_before(time, group) for group in by_key.values()]
    found = [played for played in (*held, *newest) if played is not None]
    oldest = min((played.log_time for played in newest if played is not None), default=time)
    start = max(oldest - _TRANSFORMS_NS, recording.start_ns)
    transforms = list(recording.messages(start, time, moving)) if moving else []
    return sorted([*found, *transforms], key=lambda played: played.log_time)
