"""The transform buffer: where every frame is and was, as far as this process has heard."""

from __future__ import annotations

import bisect
import logging
import threading
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from zsight import limits
from zsight.convert import matrix_of
from zsight.errors import ZsightError
from zsight_core.interpolation import interpolate
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_protocol.geometry import TransformList

__all__ = ["TransformBuffer", "TransformUnknown"]

log = logging.getLogger(__name__)

_WENT_BACK_NS = 5 * 10**9  # a transform this much older than the newest: a recording that is played went back
_HISTORY_NS = 10 * 10**9  # how long a moving transform is remembered


class TransformUnknown(ZsightError):
    """A transform cannot be told: a link is missing, or the time is before or after all that was heard."""

    exit_code = 2


@dataclass
class _Link:
    """How a child sits in its parent: always the same, or at certain times, in order."""

    parent: str
    static: NDArray[np.float64] | None = None
    times: deque[int] = field(default_factory=deque)
    matrices: deque[NDArray[np.float64]] = field(default_factory=deque)

    def put(self, stamp_ns: int, T_parent_child: NDArray[np.float64]) -> None:
        if self.times and stamp_ns < self.times[-1] - _WENT_BACK_NS:
            while self.times and self.times[-1] > stamp_ns:  # what was ahead is not known yet
                self.times.pop()
                self.matrices.pop()
        place = bisect.bisect_right(self.times, stamp_ns)
        if place and self.times[place - 1] == stamp_ns:
            self.matrices[place - 1] = T_parent_child
            return
        self.times.insert(place, stamp_ns)
        self.matrices.insert(place, T_parent_child)
        while self.times[-1] - self.times[0] > _HISTORY_NS or len(self.times) > limits.TRANSFORMS:
            self.times.popleft()
            self.matrices.popleft()

    def at(self, stamp_ns: int | None, child: str) -> NDArray[np.float64]:
        if self.static is not None:
            return self.static
        if stamp_ns is None:
            return self.matrices[-1]
        early, late = self.times[0] - stamp_ns, stamp_ns - self.times[-1]
        if early > 0 or late > 0:
            side, gap = ("before the oldest", early) if early > 0 else ("after the newest", late)
            words = f"the time asked for is {gap / 1e9:.3f} s {side} transform from {child} to {self.parent}"
            raise TransformUnknown(f"{words}: are the hosts' clocks together? See: zsight node clocks")
        after = bisect.bisect_left(self.times, stamp_ns)
        if self.times[after] == stamp_ns:
            return self.matrices[after]
        before = after - 1
        fraction = (stamp_ns - self.times[before]) / (self.times[after] - self.times[before])
        return interpolate(self.matrices[before], self.matrices[after], fraction)


class TransformBuffer:
    """A tree of frames with time; thread-safe."""

    def __init__(self) -> None:
        """No frame is known yet."""
        self._links: dict[str, _Link] = {}
        self._lock = threading.Lock()

    def put(self, transforms: TransformList, *, static: bool = False) -> None:
        """Take in transforms; a static one holds for all times and replaces what was known of its child.

        Of two of the same time the later one counts. Frames beyond their greatest number are left out.
        """
        with self._lock:
            for entry in transforms.transforms:
                child, parent, T = entry.child_frame_id, entry.header.frame_id, matrix_of(entry.transform)
                if child not in self._links and len(self._links) >= limits.FRAMES:
                    log.warning("frame %s is left out: %d frames are known already", child, len(self._links))
                    continue
                if static:
                    self._links[child] = _Link(parent, static=T)
                    continue
                link = self._links.get(child)
                if link is None or link.parent != parent or link.static is not None:
                    link = self._links[child] = _Link(parent)
                link.put(entry.header.stamp.ns, T)

    def frames(self) -> set[str]:
        """All frames that were heard of."""
        with self._lock:
            return set(self._links) | {link.parent for link in self._links.values()}

    def root_of(self, frame: str) -> str:
        """The last parent above a frame; the frame itself where none is known."""
        return self._ancestors(frame)[-1]

    def lookup(self, target: str, source: str, stamp_ns: int | None = None) -> NDArray[np.float64]:
        """T_target_source (4, 4) at a time (ns since the epoch), or with the newest of every link where none is given.

        Raises:
            TransformUnknown: no chain leads from source to target, or a link is not known at that time; says which.
        """
        ways = self._ways(target, source)
        if ways is None:
            above_source, above_target = self._ancestors(source), self._ancestors(target)
            known = ", ".join(sorted(self.frames())) or "none"
            ends = f"{source} leads up to {above_source[-1]}, {target} to {above_target[-1]}"
            raise TransformUnknown(f"no transform from {source} to {target}: {ends}; known frames: {known}")
        T_common_source, T_common_target = (self._chain(frames, stamp_ns) for frames in ways)
        return inverse(T_common_target) @ T_common_source

    def links(self, target: str, source: str) -> list[tuple[str, str, bool]]:
        """What a lookup goes through, from the source on: parent, child, whether it is static; [] where no chain is."""
        up, down = self._ways(target, source) or ([], [])
        with self._lock:
            links = [(child, self._links[child]) for child in (*up, *reversed(down))]
        return [(link.parent, child, link.static is not None) for child, link in links]

    def _ways(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """The frames from the source and from the target up to below the first that is above both."""
        above_source, above_target = self._ancestors(source), self._ancestors(target)
        common = next((frame for frame in above_source if frame in above_target), None)
        if common is None:
            return None
        return above_source[: above_source.index(common)], above_target[: above_target.index(common)]

    def _ancestors(self, frame: str) -> list[str]:
        """The frame, its parent, and so on up to its root."""
        with self._lock:
            chain = [frame]
            while (link := self._links.get(chain[-1])) is not None and link.parent not in chain:
                chain.append(link.parent)
            return chain

    def _chain(self, frames: list[str], stamp_ns: int | None) -> NDArray[np.float64]:
        """T (4, 4) from the first of some frames to the parent of the last."""
        T = np.eye(4)
        with self._lock:
            for frame in frames:
                T = self._links[frame].at(stamp_ns, frame) @ T
        return T
