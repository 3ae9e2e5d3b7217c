"""One answer from the answers of many finders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, overload

import numpy as np

from zsight_protocol.find_object import Status

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from zsight_protocol.find_object import DetectedObject, FindObjectResult

__all__ = ["MergedAnswer", "MergedObject", "merge"]


@dataclass(frozen=True)
class MergedObject:
    """One physical object: the most probable answer, who gave it, and what the other finders say of the same place.

    ``denied`` are finders that answered in the same frame and did not find it.
    """

    best: DetectedObject
    finder: str
    others: tuple[tuple[str, DetectedObject], ...] = ()
    frame_id: str = ""
    denied: tuple[str, ...] = ()

    @property
    def disagreement_m(self) -> float:
        """The greatest distance between the places that finders give, metres."""
        return max((float(np.linalg.norm(_place(self.best) - _place(other))) for _, other in self.others), default=0.0)


@dataclass(frozen=True)
class MergedAnswer(Sequence[MergedObject]):
    """The objects that some finders found, the most probable first, with each finder's own answer.

    ``silent`` tells of the finders that gave none: why, by name.
    """

    objects: tuple[MergedObject, ...]
    results: tuple[FindObjectResult, ...] = ()
    silent: Mapping[str, str] = field(default_factory=dict)

    @property
    def status(self) -> Status:
        """Found where anybody found one; else not found where anybody could tell."""
        said = [result.status for result in self.results]
        return next((s for s in (Status.FOUND, Status.NOT_FOUND) if s in said), Status.CANNOT_TELL)

    @overload
    def __getitem__(self, index: int) -> MergedObject: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[MergedObject]: ...
    def __getitem__(self, index: int | slice) -> MergedObject | Sequence[MergedObject]:
        """An object by its rank."""
        return self.objects[index]

    def __len__(self) -> int:
        """How many objects there are."""
        return len(self.objects)


def merge(results: Sequence[FindObjectResult]) -> tuple[MergedObject, ...]:
    """Join the objects of several answers that are one physical object, the most probable first.

    Two answers of different finders in one frame mean the same object where their centres are nearer than half of the
    smaller one's shortest edge: no two objects of that size can stand there together.
    """
    ranked = sorted(
        ((result, found) for result in results for found in result.objects), key=lambda entry: -entry[1].score
    )
    merged: list[MergedObject] = []
    for result, found in ranked:
        finder, frame = result.finder, result.header.frame_id
        for index, known in enumerate(merged):
            told = {known.finder, *(name for name, _ in known.others)}
            if finder not in told and frame == known.frame_id and _same_place(known.best, found):
                merged[index] = MergedObject(known.best, known.finder, (*known.others, (finder, found)), frame)
                break
        else:
            merged.append(MergedObject(found, finder, (), frame))
    return tuple(_with_denials(thing, results) for thing in merged)


def _with_denials(thing: MergedObject, results: Sequence[FindObjectResult]) -> MergedObject:
    told = {thing.finder, *(name for name, _ in thing.others)}
    denied = tuple(
        r.finder
        for r in results
        if r.finder not in told and r.status is not Status.CANNOT_TELL and r.header.frame_id == thing.frame_id
    )
    return MergedObject(thing.best, thing.finder, thing.others, thing.frame_id, denied)


def _same_place(a: DetectedObject, b: DetectedObject) -> bool:
    reach = min(_shortest(a), _shortest(b)) / 2
    return float(np.linalg.norm(_place(a) - _place(b))) < reach


def _shortest(found: DetectedObject) -> float:
    """The shortest edge of its box; of a surface, whose height is zero, the shorter of the other two."""
    return min(edge for edge in (*found.size, np.inf) if edge > 0)


def _place(found: DetectedObject) -> NDArray[np.float64]:
    position = found.pose.position
    return np.array([position.x, position.y, position.z])
