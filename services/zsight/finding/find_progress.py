"""How far a find is as a whole, from how far its stages are."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zsight_core.scene import Checkpoint

__all__ = ["FindProgress"]

_SCENE = 0.1  # share of the scene stage in the time of a find of one type
_SCENE_STAGES = ("view", "support", "segments")
_OF_A_TYPE = {"propose": (0.0, 0.4), "look": (0.4, 0.5), "refine": (0.5, 1.0)}
"""From where to where each stage of the search for one type reaches."""


class FindProgress:
    """A checkpoint for the finder's stages that hands the fraction of the whole on; it never goes back."""

    def __init__(self, checkpoint: Checkpoint, types: int = 1) -> None:
        """Args: the checkpoint of the goal; how many types are searched, one after the other."""
        self._checkpoint = checkpoint
        self._types = types
        self._before = 0.0  # share of the types that have been searched
        self._done = 0.0

    def __call__(self, stage: str, fraction: float) -> None:
        """Where a stage stands.

        Raises:
            Cancelled: raised by the goal's checkpoint.
        """
        self._done = max(self._done, self._whole(stage, fraction))
        self._checkpoint(stage, self._done)

    def _whole(self, stage: str, fraction: float) -> float:
        if stage in _SCENE_STAGES:
            return _SCENE * fraction
        if stage == "search":
            self._before = fraction
            return _SCENE + (1 - _SCENE) * fraction
        first, last = _OF_A_TYPE.get(stage, (0.0, 0.0))
        within = first + (last - first) * fraction
        return _SCENE + (1 - _SCENE) * (self._before + within / self._types) if within else 0.0
