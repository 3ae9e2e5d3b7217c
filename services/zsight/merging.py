"""One answer from the answers of many finders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_protocol.find_object import DetectedObject, FindObjectResult

__all__ = ["MergedObject", "merge"]


@dataclass(frozen=True)
class MergedObject:
    """One physical object: the most probable answer, who gave it, and what the other finders say of the same place."""

    best: DetectedObject
    finder: str
    others: tuple[tuple[str, DetectedObject], ...] = ()

    @property
    def disagreement_m(self) -> float:
        """The greatest distance between the places that finders give, metres."""
        return max((float(np.linalg.norm(_place(self.best) - _place(other))) for _, other in self.others), default=0.0)


def merge(results: list[FindObjectResult]) -> list[MergedObject]:
    """Join the objects of several answers that are one physical object, the most probable first.

    Two answers of different finders mean the same object where their centres are nearer than half of the smaller one's
    shortest edge: no two objects of that size can stand there together. Answers must be in one frame.
    """
    ranked = sorted(
        ((result.finder, found) for result in results for found in result.objects), key=lambda entry: -entry[1].score
    )
    merged: list[MergedObject] = []
    for finder, found in ranked:
        for index, known in enumerate(merged):
            told = {known.finder, *(name for name, _ in known.others)}
            if finder not in told and _same_place(known.best, found):
                merged[index] = MergedObject(known.best, known.finder, (*known.others, (finder, found)))
                break
        else:
            merged.append(MergedObject(found, finder))
    return merged


def _same_place(a: DetectedObject, b: DetectedObject) -> bool:
    reach = min(_shortest(a), _shortest(b)) / 2
    return float(np.linalg.norm(_place(a) - _place(b))) < reach


def _shortest(found: DetectedObject) -> float:
    """The shortest edge of its box; of a surface, whose height is zero, the shorter of the other two."""
    return min(edge for edge in (*found.size, np.inf) if edge > 0)


def _place(found: DetectedObject) -> NDArray[np.float64]:
    position = found.pose.position
    return np.array([position.x, position.y, position.z])
