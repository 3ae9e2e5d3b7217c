"""Names that stay with objects over successive finds."""

from __future__ import annotations

import itertools
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Tracks"]

REACH = 0.15
"""Metres within which an object that was found again is the same one, moved."""

_MOST = 1000  # objects that are remembered; the ones not seen for longest are forgotten


@dataclass(eq=False)
class _Track:
    name: str
    type: str
    place: NDArray[np.float64]


class Tracks:
    """Remembers objects by type and place, in a frame that does not move with the camera where one is known."""

    def __init__(self) -> None:
        """Nothing has been seen yet."""
        self._tracks: list[_Track] = []
        self._numbers: dict[str, itertools.count[int]] = {}
        self._lock = threading.Lock()

    def follow(self, types: Sequence[str], places: NDArray[np.float64]) -> list[str]:
        """Names of objects found at one time, such as cube-1.

        Each is the nearest of its type known before, all taken together so that the sum of squared distances is least
        (assignment problem), where that is nearer than REACH; else it is a new one.

        Args:
            types: N types.
            places: (N, 3) centres, metres, always in the same frame.
        """
        with self._lock:
            followed: list[_Track | None] = [None] * len(types)
            for kind in sorted(set(types)):
                mine = [k for k, name in enumerate(types) if name == kind]
                known = [track for track in self._tracks if track.type == kind]
                for k, track in _nearest(places[mine], known):
                    followed[mine[k]] = track
            seen = [track or self._new(types[k]) for k, track in enumerate(followed)]
            for track, place in zip(seen, places, strict=True):
                track.place = place
            self._tracks = [*(track for track in self._tracks if track not in seen), *seen][-_MOST:]
            return [track.name for track in seen]

    def _new(self, kind: str) -> _Track:
        number = next(self._numbers.setdefault(kind, itertools.count(1)))
        return _Track(f"{kind}-{number}", kind, np.zeros(3))


def _nearest(places: NDArray[np.float64], known: list[_Track]) -> list[tuple[int, _Track]]:
    """Which of the known ones each place is of."""
    if not known:
        return []
    from scipy.optimize import linear_sum_assignment

    gaps = np.linalg.norm(places[:, np.newaxis] - np.array([track.place for track in known]), axis=2)
    rows, columns = linear_sum_assignment(np.minimum(gaps, REACH) ** 2)
    return [(int(k), known[c]) for k, c in zip(rows, columns, strict=True) if gaps[k, c] < REACH]
