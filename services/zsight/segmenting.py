"""What ``zsight segment`` says, saves and draws of a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.errors import UsageError
from zsight_core import picture
from zsight_core.files.atomic_file import atomic_file
from zsight_core.points import from_xyz, xyz

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.scene import Scene

__all__ = ["draw", "save_labels", "segment_json"]

# Colours that stay apart without red-green vision (Okabe and Ito 2008).
_COLOURS = np.array(
    [[230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66], [0, 114, 178], [213, 94, 0], [204, 121, 167]],
    np.uint8,
)
_SUPPORT, _OTHER = (120, 120, 120), (60, 64, 70)


def segment_json(scene: Scene) -> dict[str, Any]:
    """The object that ``segment --json`` prints."""
    support = None
    if scene.supports:
        best = scene.supports[0]
        support = {"normal": best.normal.tolist(), "distance": float(best.distance)}
    objects = [
        {
            "label": segment.label,
            "points": segment.points,
            "centroid": segment.centroid.tolist(),
            "size": segment.size.tolist(),
        }
        for segment in scene.segments
    ]
    return {"support": support, "objects": objects, "timings_ms": scene.timings_ms}


def save_labels(path: Path, labels: NDArray[np.int32], *, overwrite: bool) -> None:
    """Write labels (H, W) as .npy; the file appears whole or not at all.

    Raises:
        FileError: it cannot be written.
        UsageError: it exists and overwrite is not given.
    """
    if path.exists() and not overwrite:
        raise UsageError(f"{path} is there already: choose another name, or give --force to overwrite it")
    with atomic_file(path, overwrite=overwrite) as file:
        np.save(file, labels.astype(np.int32))


def draw(path: Path, points: Points, scene: Scene) -> None:
    """Draw the cloud in the colours of its labels."""
    colours = np.empty((*scene.labels.shape, 3), np.uint8)
    colours[:] = _OTHER
    colours[scene.labels == 1] = _SUPPORT
    objects = scene.labels >= 2
    colours[objects] = _COLOURS[(scene.labels[objects] - 2) % len(_COLOURS)]
    legend = picture.Legend((f"{len(scene.segments)} objects",), title="segments")
    picture.save_png(path, picture.draw(from_xyz(xyz(points), colours), [legend]))
