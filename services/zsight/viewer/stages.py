"""What a stage makes of one cloud with certain settings: which points it keeps, and why the others go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from zsight.patch_plane import plane_of_patch
from zsight_core import voxel_grid
from zsight_core.take import take

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from zsight_core.points import Points

__all__ = ["STAGES", "StageResult"]


@dataclass(frozen=True, eq=False)
class StageResult:
    """Points (1, M) that are kept, points that are removed, each in the frame of the cloud; and words."""

    kept: Points
    removed: Points
    words: str


def _voxel(points: Points, patch: Points | None, settings: Mapping[str, Any]) -> StageResult:
    del patch
    kept = voxel_grid.voxel_grid(points, settings["leaf"])
    return StageResult(kept, kept[:, :0], f"{points.size:,} points in, {kept.size:,} averaged points out")


def _planes(points: Points, patch: Points | None, settings: Mapping[str, Any]) -> StageResult | None:
    """Removed is what the rectangle holds and the plane does not: it lies too far from it, or is not connected."""
    if patch is None:
        return None
    names = {"tolerance": "tolerance", "connected_only": "connected", "gap": "gap"}
    found = plane_of_patch(points, patch, **{name: settings[setting] for name, setting in names.items()})
    on = plane_of_patch(patch, patch, tolerance=settings["tolerance"]).members
    kept, removed = take(points, found.members), take(patch, ~on)
    words = f"{kept.size:,} points in the plane; of the patch {removed.size:,} lie farther than the tolerance from it"
    return StageResult(kept, removed, words)


STAGES: dict[str, Callable[[Points, Points | None, Mapping[str, Any]], StageResult | None]] = {
    "voxel": _voxel,
    "planes": _planes,
}
"""By service: the cloud, the patch last selected, and the settings in; nothing comes out where the patch is missing."""
