"""How well the scene stage parts real table scenes into objects: figures by category over labelled recordings.

The figures are those of Xie et al., The best of both modes (CoRL 2019): objects found and true are matched one to one
for the largest sum of F; overlap counts pixels, boundary counts outline pixels within a few pixels of the other
outline, and an object counts as found where its F is above 0.75. The parts of an object that something hides the middle
of count as one object. All recordings were looked at while the rules were made; the figures of every second recording
and of the others show how even they are, and ``--sensitivity`` how they change when a parameter is moved.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import linear_sum_assignment

from zsight_core import scene, segments, wholes
from zsight_core.files import pcd
from zsight_core.model import size_of
from zsight_core.shape_measurement import measure_shape

if TYPE_CHECKING:
    from numpy.typing import NDArray

DATA = Path(os.environ.get("ZSIGHT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
CATEGORIES = {"boxes": range(17), "stacked": range(17, 25), "occluded": range(25, 33), "cylindric": range(33, 45)}
TARGETS = {"overlap F": 0.90, "boundary F": 0.80, "objects above F 0.75": 0.85, "exact counts": 0.80}
PARAMETERS = (
    (segments, "CONCAVE"),
    (segments, "SMOOTH"),
    (wholes, "SAME_HEIGHT"),
    (wholes, "HOLLOW"),
    (wholes, "CRUMB"),
    (wholes, "SAME_COLOUR"),
)
"""What ``--sensitivity`` moves; those that compiled kernels hold as constants cannot be."""

NEAR = 0.0025
"""Share of the image's diagonal by which outlines may differ."""


DIMENSIONS = (
    ("can", "moveit/drinks_can.pcd", (-0.06, 0.15, 0.94), {"width": 53.0, "height": 134.0}),
    (
        "milk carton",
        "pcl/milk_cartoon_all_small_clorox.pcd",
        (-0.06, 0.13, -0.78),
        {"width": 95.0, "depth": 95.0, "height": 228.0},
    ),
)
"""What it is, its recording, about where it stands there (metres), and its size as far as known (millimetres)."""

DIMENSION_DOUBT = 5.0
"""Millimetres within which those sizes are known: the can's was measured on this cloud, the carton is a usual one."""


@dataclass(frozen=True)
class Figures:
    """Of one scene: overlap and boundary F, objects above F 0.75, true objects, objects found, time."""

    overlap: float
    boundary: float
    well_found: int
    true: int
    found: int
    milliseconds: float


def measure(path: Path) -> Figures:
    """Segment one recording and compare it with its labels."""
    points = pcd.read(path).points
    start = perf_counter()
    labels = scene.understand(points).labels
    milliseconds = (perf_counter() - start) * 1e3
    truth = points["label"].astype(np.int32)
    truth = np.where(truth >= 10, truth // 10, np.minimum(truth, 1))
    return compare(labels, truth, milliseconds)


def compare(labels: NDArray[np.int32], truth: NDArray[np.int32], milliseconds: float = 0.0) -> Figures:
    """Figures of labels (H, W) against true labels (H, W); objects are numbered from 2 in both."""
    found = [labels == k for k in np.unique(labels[labels >= 2])]
    true = [truth == k for k in np.unique(truth[truth >= 2])]
    shared = np.array([[float((t & f).sum()) for f in found] for t in true]).reshape(len(true), len(found))
    sizes_true = np.array([t.sum() for t in true], dtype=float)
    sizes_found = np.array([f.sum() for f in found], dtype=float)
    F = 2 * shared / (sizes_true[:, np.newaxis] + sizes_found)
    rows, columns = linear_sum_assignment(-F)
    overlap = _f(shared[rows, columns].sum(), sizes_found.sum(), shared[rows, columns].sum(), sizes_true.sum())
    edges_found, edges_true = [_outline(f) for f in found], [_outline(t) for t in true]
    radius = round(NEAR * float(np.hypot(*labels.shape)))
    ball = np.hypot(*np.mgrid[-radius : radius + 1, -radius : radius + 1]) <= radius
    near = [
        (edges_found[j] & binary_dilation(edges_true[i], ball), edges_true[i] & binary_dilation(edges_found[j], ball))
        for i, j in zip(rows, columns, strict=True)
    ]
    boundary = _f(
        float(sum(a.sum() for a, _ in near)),
        float(sum(e.sum() for e in edges_found)),
        float(sum(b.sum() for _, b in near)),
        float(sum(e.sum() for e in edges_true)),
    )
    return Figures(overlap, boundary, int((F[rows, columns] > 0.75).sum()), len(true), len(found), milliseconds)


def rows_of(figures: dict[str, Figures]) -> list[dict[str, Any]]:
    """One row a category, half and figure, and over all."""
    number = {name: int(name.removeprefix("learn")) for name in figures}
    groups = {category: [n for n in figures if number[n] in span] for category, span in CATEGORIES.items()}
    ordered = sorted(figures, key=lambda n: number[n])
    groups |= {"every second": ordered[::2], "the others": ordered[1::2], "all": ordered}
    return [row for group, names in groups.items() if names for row in _rows(group, [figures[n] for n in names])]


def _rows(group: str, figures: list[Figures]) -> list[dict[str, Any]]:
    values = {
        "overlap F": float(np.mean([f.overlap for f in figures])),
        "boundary F": float(np.mean([f.boundary for f in figures])),
        "objects above F 0.75": sum(f.well_found for f in figures) / sum(f.true for f in figures),
        "exact counts": float(np.mean([f.true == f.found for f in figures])),
    }
    rows = [
        {
            "name": f"segmentation {group} {name}",
            "value": round(value, 4),
            "unit": "",
            "peer": None,
            "peer_value": None,
            "ratio": None,
            "target": TARGETS[name],
            "holds": value >= TARGETS[name],
        }
        for name, value in values.items()
    ]
    median = float(np.median([f.milliseconds for f in figures]))
    rows.append({"name": f"segmentation {group} time", "value": round(median, 1), "unit": "ms", "peer": None})
    rows[-1] |= {"peer_value": None, "ratio": None, "target": 12.0, "holds": median <= 12.0}
    return rows


def plane_rows() -> list[dict[str, Any]]:
    """How far the table found is from the plane through the points that are labelled as table.

    Height is that of our plane over the other one below the middle of the objects; both are fitted to the same noisy
    points (1.7 mm root mean square and more), and differently, so that the difference says little below that.
    """
    truth = json.loads((DATA / "mosd_learn" / "truth.json").read_text(encoding="utf-8"))
    angles, heights = [], []
    for path in sorted((DATA / "mosd_learn").glob("learn*.pcd")):
        true = truth[path.stem]
        normal, offset = np.array(true["plane_normal"]), float(true["plane_d"])
        supports = scene.understand(pcd.read(path).points).supports
        middle = np.mean([thing["centroid"] for thing in true["objects"].values()], axis=0)
        foot = middle - (normal @ middle + offset) * normal
        best = supports[0]
        angles.append(float(np.degrees(np.arccos(min(1.0, abs(float(best.normal @ normal)))))))
        heights.append(abs(float(best.normal @ foot - best.distance)) * 1e3)
    return [
        _row(f"segmentation plane {name} {quantile}", float(value), unit)
        for name, values, unit in (("tilt", angles, "deg"), ("height", heights, "mm"))
        for quantile, value in (("median", np.median(values)), ("p95", np.quantile(values, 0.95)))
    ]


def dimension_rows() -> list[dict[str, Any]]:
    """Sizes that ``zsight catalog teach`` measures of real things, beside what is known of them."""
    rows = []
    for name, file, place, known in DIMENSIONS:
        path = DATA / file
        if not path.is_file():
            continue
        seen = scene.understand(pcd.read(path).points)
        segment = min(seen.segments, key=lambda s: float(np.linalg.norm(s.centroid - place)))
        edges = sorted(set(size_of(measure_shape(seen, segment).shape)[:2]))
        found = {"height": segment.high, "width": edges[0], "depth": edges[-1]}
        for edge, millimetres in known.items():
            rows.append(_row(f"segmentation {name} {edge}", found[edge] * 1e3, "mm", peer_value=millimetres))
            rows[-1]["holds"] = abs(found[edge] * 1e3 - millimetres) <= DIMENSION_DOUBT
            rows[-1]["target"] = f"{millimetres:g} +- {DIMENSION_DOUBT:g}"
    return rows


def _row(name: str, value: float, unit: str, peer_value: float | None = None) -> dict[str, Any]:
    return {
        "name": name,
        "value": round(value, 3),
        "unit": unit,
        "peer": "known" if peer_value is not None else None,
        "peer_value": peer_value,
        "ratio": round(value / peer_value, 4) if peer_value else None,
        "target": None,
        "holds": None,
    }


def _outline(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels of a mask beside pixels that are not."""
    padded = np.pad(mask, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask & ~inner


def _f(right_found: float, found: float, right_true: float, true: float) -> float:
    """Harmonic mean of precision and recall."""
    precision, recall = right_found / max(found, 1.0), right_true / max(true, 1.0)
    return 2 * precision * recall / max(precision + recall, 1e-12)


def run() -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them; none where the recordings are not there."""
    scene.warm_up()
    return rows_of(measure_all()) + plane_rows() + dimension_rows()


def measure_all() -> dict[str, Figures]:
    """Figures of all recordings by name."""
    return {path.stem: measure(path) for path in sorted((DATA / "mosd_learn").glob("learn*.pcd"))}


def sensitivity() -> None:
    """Print the figures over all recordings with one parameter at a time a third smaller and a third larger."""
    for module, name in PARAMETERS:
        usual = getattr(module, name)
        for factor in (0.67, 1.0, 1.5):
            setattr(module, name, type(usual)(usual * factor))
            rows = _rows("", list(measure_all().values()))[:4]
            figures = " ".join(f"{row['name'].removeprefix('segmentation').strip()} {row['value']:.3f}" for row in rows)
            print(f"{name:14} x {factor:4} {figures}")
        setattr(module, name, usual)


def main() -> None:
    """Print the rows as JSON or as a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--each", action="store_true", help="also a line a recording")
    parser.add_argument("--sensitivity", action="store_true", help="move one parameter at a time instead")
    arguments = parser.parse_args()
    scene.warm_up()
    if arguments.sensitivity:
        sensitivity()
        return
    figures = measure_all()
    rows = rows_of(figures) + plane_rows() + dimension_rows()
    if arguments.json:
        machine = {"processor": platform.processor() or platform.machine(), "system": platform.platform()}
        print(json.dumps({"machine": machine, "rows": rows}))
        return
    if arguments.each:
        for name, f in figures.items():
            print(f"{name:9} overlap {f.overlap:.3f} boundary {f.boundary:.3f} found {f.found} of {f.true}")
    for row in rows:
        verdict = "MISSED" if row["holds"] is False else ""
        print(f"{row['name']:48} {row['value']:8} {row['unit']:3} target {row['target']} {verdict}")


if __name__ == "__main__":
    main()
