"""What ``zsight segment`` says, saves and draws of a scene."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight_core import picture
from zsight_core.errors import FileError
from zsight_core.points import from_xyz, xyz

if TYPE_CHECKING:
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
        FileError: it exists and overwrite is not given, or cannot be written.
    """
    if path.exists() and not overwrite:
        raise FileError(path, "exists already; give --force to overwrite it")
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as beside:
            np.save(beside, labels.astype(np.int32))
        Path(beside.name).chmod(0o666 & ~_umask())
        Path(beside.name).replace(path)
    except OSError as error:
        raise FileError(path, f"cannot be written ({error.strerror})") from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def draw(path: Path, points: Points, scene: Scene) -> None:
    """Draw the cloud in the colours of its labels."""
    colours = np.empty((*scene.labels.shape, 3), np.uint8)
    colours[:] = _OTHER
    colours[scene.labels == 1] = _SUPPORT
    objects = scene.labels >= 2
    colours[objects] = _COLOURS[(scene.labels[objects] - 2) % len(_COLOURS)]
    legend = picture.Legend((f"{len(scene.segments)} objects",), title="segments")
    picture.save_png(path, picture.draw(from_xyz(xyz(points), colours), [legend]))
