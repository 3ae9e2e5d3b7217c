"""What a stage makes of one cloud with certain settings: which points it keeps, and why the others go."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.patch_plane import plane_of_patch
from zsight.viewer.box_lines import corners_of, edges_of
from zsight_core import scene as scene_core
from zsight_core import voxel_grid
from zsight_core.above_plane import above_mask, points_above
from zsight_core.filters import finite_mask
from zsight_core.points import xyz
from zsight_core.scene_limits import SceneLimits
from zsight_core.scene_reasons import Reason, reasons
from zsight_core.transform import transform_xyz

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.scene import Segment

__all__ = ["STAGES", "Fate", "Seen", "StageResult"]

# Colours that everybody tells apart (Okabe and Ito 2008).
_ORANGE, _SKY, _GREEN, _YELLOW = (230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66)
_BLUE, _RED, _PURPLE, _GREY = (0, 114, 178), (213, 94, 0), (204, 121, 167), (120, 120, 120)


@dataclass(frozen=True, eq=False)
class Seen:
    """What a stage sees: a cloud (H, W), the patch of it last selected (1, M), and T_world_camera (4, 4) if known."""

    points: Points
    patch: Points | None
    T_world_camera: NDArray[np.float64] | None


@dataclass(frozen=True)
class Fate:
    """What became of so many points, and the colour that they are drawn in; without one they are not drawn."""

    name: str
    count: int
    colour: tuple[int, int, int] | None = None


@dataclass(frozen=True, eq=False)
class StageResult:
    """Points (N, 3) with colours (N, 3), edges (E, 2, 3) of boxes around things, in the frame of the cloud; words."""

    xyz: NDArray[np.float32]
    colours: NDArray[np.uint8]
    fates: tuple[Fate, ...]
    words: str
    edges: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2, 3)))


def _voxel(seen: Seen, settings: Mapping[str, Any]) -> StageResult:
    kept = voxel_grid.voxel_grid(seen.points, settings["leaf"])
    measured = int(finite_mask(seen.points).sum())
    fates = (
        Fate("averaged points", kept.size, _ORANGE),
        Fate("went into them", measured),
        Fate("without depth", seen.points.size - measured),
    )
    coordinates = xyz(kept).reshape(-1, 3)
    colours = np.full(coordinates.shape, _ORANGE, np.uint8)
    words = f"{seen.points.size:,} points in, {kept.size:,} averaged points out"
    return StageResult(coordinates, colours, fates, words)


def _planes(seen: Seen, settings: Mapping[str, Any]) -> StageResult | str:
    """The plane of the patch; with the points above it where they are published."""
    if seen.patch is None:
        return "Select a rectangle first: the plane is that of its points."
    tolerance, points = settings["tolerance"], seen.points
    whole = plane_of_patch(points, seen.patch, tolerance=tolerance)
    found = whole
    if settings["connected"]:
        found = plane_of_patch(points, seen.patch, tolerance=tolerance, connected_only=True, gap=settings["gap"])
    strayed = seen.patch.size - int(plane_of_patch(seen.patch, seen.patch, tolerance=tolerance).members.sum())
    groups = [
        ("in the plane", xyz(points)[found.members], _ORANGE),
        ("in the plane, not connected to the patch", xyz(points)[whole.members & ~found.members], _PURPLE),
    ]
    if settings["above"]:
        low, high, plane = settings["above_low"], settings["above_high"], found.fit.plane
        standing = points_above(points, plane, low, high, found.members)
        higher = points_above(points, plane, high, np.inf, found.members) if high > low else standing[:, :0]
        groups += [
            ("above the plane", xyz(standing).reshape(-1, 3), _SKY),
            ("higher than above_high", xyz(higher).reshape(-1, 3), _BLUE),
        ]
        lower = above_mask(points, plane, min(tolerance, low), low) & ~whole.members
        groups.append(("lower than above_low", xyz(points)[lower], _GREEN))
    fates = [Fate(name, len(part), colour) for name, part, colour in groups]
    fates.append(Fate("of the patch, farther from the plane than the tolerance", strayed))
    colours = [np.full(part.shape, colour, np.uint8) for _, part, colour in groups]
    words = f"{int(found.members.sum()):,} of {points.size:,} points lie in the plane of the patch"
    coordinates = np.concatenate([part for _, part, _ in groups])
    return StageResult(coordinates, np.concatenate(colours), tuple(fates), words)


_REASONS: dict[Reason, tuple[str, tuple[int, int, int] | None]] = {
    Reason.THING: ("of a thing", _ORANGE),
    Reason.SURFACE: ("of a surface", _SKY),
    Reason.TOO_SMALL: ("of a thing too small (smallest)", _PURPLE),
    Reason.TOO_LARGE: ("of a thing too large (largest)", _RED),
    Reason.RIPPLE: ("of a ripple of the surface", _YELLOW),
    Reason.TOO_HIGH: ("higher above a surface than highest", _BLUE),
    Reason.BELOW: ("below a surface", _GREEN),
    Reason.BESIDE: ("beside all surfaces (margin)", _GREY),
    Reason.NO_DEPTH: ("without depth", None),
}


def _finder(seen: Seen, settings: Mapping[str, Any]) -> StageResult:
    """The scene stage: surfaces and what stands on them."""
    scene = scene_core.understand(
        seen.points, T_world_camera=seen.T_world_camera, limits=SceneLimits.of(dict(settings))
    )
    fate = reasons(seen.points, scene).reshape(-1)
    counts = np.bincount(fate, minlength=len(Reason))
    fates = tuple(Fate(name, int(counts[reason]), colour) for reason, (name, colour) in _REASONS.items())
    table = np.array([_REASONS[reason][1] or _GREY for reason in Reason], np.uint8)
    drawn = fate != Reason.NO_DEPTH
    words = f"{len(scene.supports)} surfaces, {len(scene.segments)} things"
    edges = np.concatenate([_edges(segment) for segment in scene.segments] or [np.zeros((0, 2, 3))])
    return StageResult(xyz(seen.points).reshape(-1, 3)[drawn], table[fate[drawn]], fates, words, edges)


def _edges(segment: Segment) -> NDArray[np.float64]:
    half = np.maximum(segment.size, 1e-3) / 2
    return edges_of(transform_xyz(segment.T_camera_box, corners_of(-half, half)).astype(np.float64))


def _camera(seen: Seen, settings: Mapping[str, Any]) -> StageResult:
    """A camera leaves out nothing by itself; where the cloud stands follows its pose."""
    del settings
    measured = int(finite_mask(seen.points).sum())
    fates = (Fate("measured", measured), Fate("without depth", seen.points.size - measured))
    words = f"{measured:,} of {seen.points.size:,} points were measured; the cloud moves with the pose"
    return StageResult(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), fates, words)


STAGES: dict[str, Callable[[Seen, Mapping[str, Any]], StageResult | str]] = {
    "camera": _camera,
    "voxel": _voxel,
    "planes": _planes,
    "finder": _finder,
}
"""By service: what is seen and the settings in; words in place of a result where something is missing."""
