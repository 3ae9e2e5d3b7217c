"""The transform buffer: where every frame is, as far as this process has heard."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import matrix_of
from zsight.errors import ZsightError
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_protocol.geometry import TransformList

__all__ = ["TransformBuffer", "TransformUnknown"]


class TransformUnknown(ZsightError):
    """No chain of transforms leads from one frame to another; the message says which link is missing."""

    exit_code = 2


@dataclass(frozen=True)
class _Link:
    parent: str
    T_parent_child: NDArray[np.float64]


class TransformBuffer:
    """Transforms by child frame; thread-safe."""

    def __init__(self) -> None:
        """No frame is known yet."""
        self._links: dict[str, _Link] = {}
        self._lock = threading.Lock()

    def put(self, transforms: TransformList) -> None:
        """Take in transforms; a newer one replaces its child's earlier one."""
        with self._lock:
            for entry in transforms.transforms:
                self._links[entry.child_frame_id] = _Link(entry.header.frame_id, matrix_of(entry.transform))

    def frames(self) -> set[str]:
        """All frames that were heard of."""
        with self._lock:
            return set(self._links) | {link.parent for link in self._links.values()}

    def root_of(self, frame: str) -> str:
        """The last parent above a frame; the frame itself where none is known."""
        return self._up(frame)[-1][0]

    def lookup(self, target: str, source: str) -> NDArray[np.float64]:
        """T_target_source (4, 4).

        Raises:
            TransformUnknown: no chain leads from source to target.
        """
        T_root_source = dict(self._up(source))
        T_target_frame = {frame: inverse(T) for frame, T in self._up(target)}
        for frame, T_frame_source in T_root_source.items():
            if frame in T_target_frame:
                return T_target_frame[frame] @ T_frame_source
        known = ", ".join(sorted(self.frames())) or "none"
        ends = f"{source} leads up to {list(T_root_source)[-1]}, {target} to {list(T_target_frame)[-1]}"
        raise TransformUnknown(f"no transform from {source} to {target}: {ends}; known frames: {known}")

    def _up(self, frame: str) -> list[tuple[str, NDArray[np.float64]]]:
        """Every frame from this one to its root, with T_ancestor_frame."""
        with self._lock:
            chain = [(frame, np.eye(4))]
            while chain[-1][0] in self._links and len(chain) <= len(self._links):
                name, T = chain[-1]
                link = self._links[name]
                chain.append((link.parent, link.T_parent_child @ T))
            return chain
