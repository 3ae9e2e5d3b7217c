"""How much the finder finds, how exactly, how sure and how fast, in simulated scenes with exact truth.

Scenes are drawn by ``zsight_core.simulation.random_scenes`` from test seeds; what is fitted, to train seeds.
Every scene is seen once, by one of two sensors, and asked for all shipped types, each with all others as rivals, as
the service asks. Poses are compared in the camera's frame, so that a wrong extrinsic is not held against the finder.
An object counts as found where an answer of its type is within 20 mm and 15 degrees (symmetries counted; a mesh: within
20 mm of symmetry-aware surface distance, or one of its equivalent poses is and the view, had it no noise, would not
tell that one from the answer either).
"""

from __future__ import annotations

import argparse
import json
import os
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import permutations, product
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.catalogue.type_files import load, shipped_folder
from zsight.cli.benching import machine
from zsight_core import find as finder
from zsight_core import scene as scene_stage
from zsight_core.model import Box, Cylinder, Mesh, ObjectModel, Sphere, Surface, size_of
from zsight_core.search.contest import NOBODY, lead
from zsight_core.simulation import camera as simulated
from zsight_core.simulation.kinect import Kinect
from zsight_core.simulation.random_scenes import LEVELS, Level, Placed, RandomScene, draw_scene
from zsight_core.simulation.time_of_flight import TimeOfFlight
from zsight_core.solid import solid_of
from zsight_core.transform import angle_between, inverse, transform_xyz

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from zsight_core.find import Answer, Detection
    from zsight_core.model import Shape

TRAIN, TEST = 0, 1_000_000
"""First seeds; the n-th scene of a level has the n-th seed from there."""

SCENES = int(os.environ.get("ZSIGHT_BENCH_SCENES", "8"))
"""Scenes a level; half of them by each sensor. The default takes about three minutes of one core."""

NOISES: dict[str, Kinect | TimeOfFlight] = {"kinect": Kinect(), "time_of_flight": TimeOfFlight()}
RECALL = {"alone": 0.99, "+3": 0.99, "+7": 0.97, "+11 touching": 0.93, "+16 occluded": 0.85, "stacked": 0.90}
NEAR, TURNED = 0.02, 15.0
LARGELY_SEEN = 0.5
CLEARLY_TOLD = 40.0
"""Pixels of a view without noise by which the true pose must lead for another one to be plainly wrong."""

EXACT = 1e-4
"""Standard deviation of 1 / z in such a view, 1/m."""

CHI_SQUARE_MEDIAN = 2.366
"""Median of the squared normalised error of three coordinates."""

Row = dict[str, Any]


@dataclass
class Tally:
    """What the scenes of a level, a sensor or all come to."""

    scenes: int = 0
    true: int = 0
    hit: int = 0
    answers: list[tuple[float, bool]] = field(default_factory=list)
    absent: int = 0
    alarms: int = 0
    lookalikes: int = 0
    taken_in: int = 0
    positions: list[float] = field(default_factory=list)
    rotations: list[float] = field(default_factory=list)
    surfaces: list[float] = field(default_factory=list)
    normalised: list[float] = field(default_factory=list)
    plane_heights: list[float] = field(default_factory=list)
    plane_angles: list[float] = field(default_factory=list)
    scene_ms: list[float] = field(default_factory=list)
    simple_ms: list[float] = field(default_factory=list)
    mesh_ms: list[float] = field(default_factory=list)
    catalogue_ms: list[float] = field(default_factory=list)
    misses: list[dict[str, Any]] = field(default_factory=list)
    wrong: list[dict[str, Any]] = field(default_factory=list)


def merged(tallies: Iterable[Tally]) -> Tally:
    """The sum of some tallies."""
    total = Tally()
    for tally in tallies:
        for name, value in vars(tally).items():
            setattr(total, name, getattr(total, name) + value)
    return total


@cache
def catalogue() -> tuple[ObjectModel, ...]:
    """All shipped solids, by name."""
    return tuple(model for model in load(shipped_folder()).models() if not isinstance(model.shape, Surface))


def measure(level: Level, seed: int, noise: str | None) -> Tally:
    """Draw, see and ask one scene."""
    drawn = draw_scene(level, seed, catalogue())
    points = simulated.expose(drawn.view, drawn.camera.pinhole, NOISES[noise] if noise else None, seed)
    tally = Tally(scenes=1)
    scene, milliseconds = _timed(lambda: scene_stage.understand(points, T_world_camera=drawn.T_world_camera))
    tally.scene_ms.append(milliseconds)

    def ask(models: tuple[ObjectModel, ...], scene: scene_stage.Scene) -> Answer:
        return finder.find(points, models, scene=scene, T_world_camera=drawn.T_world_camera, rivals=catalogue())

    answer, milliseconds = _timed(lambda: ask(catalogue(), scene))
    tally.catalogue_ms.append(milliseconds)
    for is_mesh, times in ((False, tally.simple_ms), (True, tally.mesh_ms)):
        kinds = [model for model in catalogue() if isinstance(model.shape, Mesh) == is_mesh]
        asked = kinds[seed % len(kinds)]
        scene = replace(scene)  # one that nothing was asked about yet
        times.append(_timed(partial(ask, (asked,), scene))[1])
    _compare_plane(tally, drawn, scene)
    _compare_objects(tally, drawn, scene, answer, f"{level} seed {seed} {noise}")
    return tally


def _timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """What it returns, and the processor time it takes, milliseconds."""
    start = process_time()
    result = call()
    return result, (process_time() - start) * 1e3


def _compare_plane(tally: Tally, drawn: RandomScene, scene: scene_stage.Scene) -> None:
    """Height and angle of the found surface nearest to the table's top against it."""
    if not scene.supports:
        return
    top = drawn.world.bodies[1]
    T = inverse(drawn.camera.T_world_camera) @ top.T_world_model
    T[:3, 3] += T[:3, 2] * size_of(top.model.shape)[2] / 2
    offsets = [abs(float(T[:3, 2] @ (s.T_camera_support[:3, 3] - T[:3, 3]))) for s in scene.supports]
    best = int(np.argmin(offsets))
    tally.plane_heights.append(offsets[best] * 1e3)
    cosine = float(T[:3, 2] @ scene.supports[best].normal)
    tally.plane_angles.append(float(np.degrees(np.arccos(np.clip(abs(cosine), 0, 1)))))


def _compare_objects(tally: Tally, drawn: RandomScene, scene: scene_stage.Scene, answer: Answer, where: str) -> None:
    """Answers against the truth, type by type."""
    T_camera_world = inverse(drawn.camera.T_world_camera)
    for model in catalogue():
        true = [thing for thing in drawn.objects if thing.model.name == model.name]
        answers = [d for d in answer.detections if d.type == model.name]
        if not true:
            _count_absent(tally, drawn, model, answers, T_camera_world)
        taken: set[int] = set()
        for detection in answers:
            best = _nearest(detection, model, true, taken, drawn)
            tally.answers.append((detection.score, best is not None))
            if best is None:
                tally.wrong.append(_wrong(detection, drawn, T_camera_world, where))
                continue
            taken.add(best)
            if true[best].visible >= LARGELY_SEEN and true[best].reflects == 1:
                _compare_pose(tally, detection, model, T_camera_world @ true[best].T_world_model, scene)
        for number, thing in enumerate(true):
            if thing.visible >= LARGELY_SEEN and thing.reflects == 1:
                tally.true += 1
                tally.hit += number in taken
                if number not in taken:
                    tally.misses.append(_missed(thing, answer, T_camera_world, where))


def _count_absent(
    tally: Tally, drawn: RandomScene, model: ObjectModel, answers: list[Detection], T_camera_world: NDArray[np.float64]
) -> None:
    like = next((thing for thing in drawn.objects if thing.model.name == f"{model.name}-like"), None)
    if like is None:
        tally.absent += 1
        tally.alarms += bool(answers)
        return
    there = (T_camera_world @ like.T_world_model)[:3, 3]
    reach = max(size_of(like.model.shape)) / 2
    tally.lookalikes += 1
    tally.taken_in += any(float(np.linalg.norm(d.T_camera_model[:3, 3] - there)) < reach for d in answers)


def _nearest(
    detection: Detection,
    model: ObjectModel,
    true: list[Placed],
    taken: set[int],
    drawn: RandomScene,
) -> int | None:
    """Number of the true object that a detection is right about."""
    best: tuple[float, int] | None = None
    T_camera_world = inverse(drawn.camera.T_world_camera)
    for number, thing in enumerate(true):
        T = T_camera_world @ thing.T_world_model
        distance = float(np.linalg.norm(detection.T_camera_model[:3, 3] - T[:3, 3]))
        if number in taken or not _is_right(detection, model, T, distance, drawn):
            continue
        if best is None or distance < best[0]:
            best = (distance, number)
    return None if best is None else best[1]


def _is_right(
    detection: Detection, model: ObjectModel, T: NDArray[np.float64], distance: float, drawn: RandomScene
) -> bool:
    if isinstance(model.shape, Mesh):
        if surface_distance(model.shape, replace(detection, equivalents=()), T) < NEAR:
            return True
        alike = surface_distance(model.shape, detection, T) < NEAR
        return alike and not _is_told(model.shape, T, detection.T_camera_model, drawn)
    return distance < NEAR and rotation_error(model.shape, detection.T_camera_model, T) < TURNED


def _is_told(shape: Mesh, T: NDArray[np.float64], T_other: NDArray[np.float64], drawn: RandomScene) -> bool:
    """True where the view, had it no noise, would tell the true pose of a mesh from another one."""
    solid, p = solid_of(shape), drawn.camera.pinhole
    depth = np.nan_to_num(drawn.view.depth, nan=0.0, posinf=0.0).astype(np.float32)
    nobody = np.full(depth.shape, NOBODY, np.int16)
    ahead = lead(depth, (p.fx, p.fy, p.cx, p.cy), solid.vertices, solid.faces, T, T_other, EXACT, nobody, 0)
    return ahead > CLEARLY_TOLD


def _compare_pose(
    tally: Tally, detection: Detection, model: ObjectModel, T: NDArray[np.float64], scene: scene_stage.Scene
) -> None:
    if isinstance(model.shape, Mesh):
        tally.surfaces.append(surface_distance(model.shape, detection, T) * 1e3)
        return
    error = detection.T_camera_model[:3, 3] - T[:3, 3]
    tally.positions.append(float(np.linalg.norm(error)) * 1e3)
    if not isinstance(model.shape, Sphere):
        tally.rotations.append(rotation_error(model.shape, detection.T_camera_model, T))
    there = scene.supports[detection.support].T_camera_support[:3, :3].T @ error
    tally.normalised.append(float(there @ np.linalg.solve(detection.covariance[:3, :3], there)))


def rotation_error(shape: Shape, T_a: NDArray[np.float64], T_b: NDArray[np.float64]) -> float:
    """Degrees between two poses of a shape, the least over its symmetries."""
    if isinstance(shape, Sphere):
        return 0.0
    if isinstance(shape, Cylinder):
        sine = float(np.linalg.norm(np.cross(T_a[:3, 2], T_b[:3, 2])))
        return float(np.degrees(np.arctan2(sine, abs(float(T_a[:3, 2] @ T_b[:3, 2])))))
    return float(np.degrees(min(angle_between(T_a, T_b @ S) for S in symmetries(shape))))


def surface_distance(shape: Mesh, detection: Detection, T: NDArray[np.float64]) -> float:
    """Metres that the farthest vertex is off, the least over symmetries and the poses said to be equivalent."""
    poses = (detection.T_camera_model, *detection.equivalents)
    true = [transform_xyz(T @ S, shape.vertices) for S in symmetries(shape)]
    found = [transform_xyz(pose, shape.vertices) for pose in poses]
    return min(float(np.linalg.norm(a - b, axis=1).max()) for a in found for b in true)


_KNOWN: dict[int, list[NDArray[np.float64]]] = {}


def symmetries(shape: Shape) -> list[NDArray[np.float64]]:
    """Those rotations (4, 4) of a cube that put a box or mesh onto itself."""
    key = id(shape)
    if key not in _KNOWN:
        _KNOWN[key] = [S for S in _cube_rotations() if _onto_itself(shape, S)]
    return _KNOWN[key]


def _cube_rotations() -> list[NDArray[np.float64]]:
    found = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        S = np.eye(4)
        S[:3, :3] = np.eye(3)[list(order)] * np.array(signs)[:, np.newaxis]
        if np.linalg.det(S) > 0:
            found.append(S)
    return found


def _onto_itself(shape: Shape, S: NDArray[np.float64]) -> bool:
    from scipy.spatial import cKDTree

    if isinstance(shape, Box):
        return bool(np.allclose(np.abs(S[:3, :3]) @ shape.size, shape.size))
    if not isinstance(shape, Mesh):
        return False
    return bool(np.max(cKDTree(shape.vertices).query(transform_xyz(S, shape.vertices))[0]) < 1e-4)


def _missed(thing: Placed, answer: Answer, T_camera_world: NDArray[np.float64], where: str) -> dict[str, Any]:
    """What became of a true object that no answer names."""
    there = (T_camera_world @ thing.T_world_model)[:3, 3]
    rivals = [d.type for d in answer.detections if float(np.linalg.norm(d.T_camera_model[:3, 3] - there)) < 2 * NEAR]
    rejected = [
        r
        for r in answer.report["rejected"]
        if r["type"] == thing.model.name and float(np.linalg.norm(np.array(r["position"]) - there)) < NEAR
    ]
    best = max(rejected, key=lambda r: float(r["probability"]), default=None)
    if best is None:
        cause = "no candidate within 20 mm"
    elif best["rival"]:
        cause = f"the rival {best['rival']} was preferred"
    else:
        cause = f"scored below {best['threshold']}"
    return {
        "where": where,
        "type": thing.model.name,
        "cause": cause,
        "visible": round(thing.visible, 2),
        "truncated": thing.truncated,
        "base_mm": round(thing.base * 1e3),
        "up_in_model": [round(float(x), 2) for x in thing.T_world_model[2, :3]],
        "score": None if best is None else best["probability"],
        "answers_there": rivals,
    }


def _wrong(detection: Detection, drawn: RandomScene, T_camera_world: NDArray[np.float64], where: str) -> dict[str, Any]:
    """What a wrong answer was taken from."""
    place = detection.T_camera_model[:3, 3]
    distances = [float(np.linalg.norm((T_camera_world @ o.T_world_model)[:3, 3] - place)) for o in drawn.objects]
    nearest = int(np.argmin(distances))
    thing = drawn.objects[nearest]
    same = thing.model.name == detection.type
    cause = "right object, wrong pose" if same else f"taken for it: {thing.model.name}"
    return {
        "where": where,
        "type": detection.type,
        "cause": cause,
        "score": round(detection.score, 3),
        "off_mm": round(distances[nearest] * 1e3, 1),
        "visible": round(thing.visible, 2),
        "rotation_deg": round(
            rotation_error(thing.model.shape, detection.T_camera_model, T_camera_world @ thing.T_world_model), 1
        ),
    }


def calibration_error(answers: list[tuple[float, bool]]) -> float:
    """Expected calibration error over ten bins of equal width from 0 to 1 (Guo et al. 2017)."""
    bins: dict[int, list[tuple[float, bool]]] = {}
    for score, right in answers:
        bins.setdefault(min(int(score * 10), 9), []).append((score, right))
    gaps = [abs(sum(s for s, _ in b) - sum(r for _, r in b)) for b in bins.values()]
    return float(sum(gaps)) / max(len(answers), 1)


def rows_of(tallies: dict[tuple[Level, str], Tally], book: Tally) -> list[Row]:
    """All figures beside the targets."""
    by_level = {level: merged(t for (a, _), t in tallies.items() if a == level) for level in LEVELS}
    by_noise = {noise: merged(t for (_, b), t in tallies.items() if b == noise) for noise in NOISES}
    everything = merged(tallies.values())
    rows = [
        _share_row(f"{level} recall", tally.hit, tally.true, RECALL.get(level))
        for level, tally in by_level.items()
        if tally.true
    ]
    for name, tally in [("all", everything), *by_level.items()]:
        right = sum(right for _, right in tally.answers)
        rows.append(_share_row(f"{name} precision", right, len(tally.answers), 0.99))
    rows.append(_share_row("absent false alarms", everything.alarms, everything.absent, 0.002, most=True))
    rows.append(_share_row("lookalike false alarms", everything.taken_in, everything.lookalikes, 0.02, most=True))
    for noise, tally in by_noise.items():
        rows += _exactness(noise, tally)
    rows.append(_row("book noise-free position", max(book.positions, default=np.inf), "mm", 0.05, most=True))
    rows.append(_row("book noise-free rotation", max(book.rotations, default=np.inf), "deg", 0.01, most=True))
    for name, times, target in (
        ("scene stage CPU p95", everything.scene_ms, 12.0),
        ("box, cylinder or sphere query CPU p95", everything.simple_ms, 35.0),
        ("mesh query CPU p95", everything.mesh_ms, 80.0),
        ("whole catalogue query CPU p95", everything.catalogue_ms, 150.0),
    ):
        rows.append(_row(name, _quantile(times, 0.95), "ms", target, most=True, of=len(times)))
    return rows


def _exactness(noise: str, tally: Tally) -> list[Row]:
    """Errors, calibration and covariance under one sensor."""
    figures = (
        ("position median", tally.positions, 0.5, "mm", 0.5),
        ("position p95", tally.positions, 0.95, "mm", 1.3),
        ("rotation median", tally.rotations, 0.5, "deg", 0.3),
        ("rotation p95", tally.rotations, 0.95, "deg", 2.0),
        ("mesh surface distance p95", tally.surfaces, 0.95, "mm", 3.0),
        ("plane height p95", tally.plane_heights, 0.95, "mm", 0.15),
        ("plane angle p95", tally.plane_angles, 0.95, "deg", 0.05),
    )
    rows = [
        _row(f"{noise} {name}", _quantile(values, share), unit, target, most=True, of=len(values))
        for name, values, share, unit, target in figures
    ]
    error, count = calibration_error(tally.answers), len(tally.answers)
    rows.append(_row(f"{noise} calibration error", error, "", 0.03, most=True, of=count))
    normalised = float(np.sqrt(_quantile(tally.normalised, 0.5) / CHI_SQUARE_MEDIAN))
    row = _row(f"{noise} normalised position error", normalised, "", 1.3, most=True, of=len(tally.normalised))
    rows.append(row | {"holds": 0.8 <= normalised <= 1.3})
    return rows


def _row(name: str, value: float, unit: str, target: float | None, *, most: bool = False, of: int | None = None) -> Row:
    """One row; ``most``: the target is an upper limit; ``of``: how many things it was measured on."""
    holds = None if target is None else bool(value <= target if most else value >= target)
    return {
        "name": f"finder {name}",
        "value": float(f"{value:.4g}"),
        "unit": unit,
        "peer": None,
        "peer_value": None,
        "ratio": None,
        "target": target,
        "holds": holds,
        "of": of,
    }


def _share_row(name: str, part: int, whole: int, target: float | None, *, most: bool = False) -> Row:
    return _row(name, part / whole if whole else float("nan"), "", target, most=most, of=whole)


def _quantile(values: list[float], share: float) -> float:
    return float(np.quantile(values, share)) if values else float("nan")


def measure_all(first: int = TEST, scenes: int = SCENES) -> tuple[dict[tuple[Level, str], Tally], Tally]:
    """Tallies by level and sensor, and of the book's scene without noise."""
    finder.warm_up()
    simulated.warm_up()
    measure("+3", first - 1 if first else TEST - 1, "kinect")  # the first call of each kind is not what is measured
    names = list(NOISES)
    tallies: dict[tuple[Level, str], Tally] = {}
    for level in LEVELS:
        for number in range(scenes):
            key = (level, names[number % len(names)])
            tallies[key] = merged([tallies.get(key, Tally()), measure(level, first + number, key[1])])
    return tallies, measure("book", first, None)


def run() -> list[Row]:
    """Rows as ``zsight bench --json`` prints them."""
    return rows_of(*measure_all())


def failures(tallies: dict[tuple[Level, str], Tally]) -> dict[str, Any]:
    """Misses and wrong answers with their causes, most frequent first."""
    everything = merged(tallies.values())
    causes = {
        kind: Counter(f"{entry['type']}: {entry['cause']}" for entry in entries).most_common()
        for kind, entries in (("missed", everything.misses), ("wrong", everything.wrong))
    }
    return {"causes": causes, "missed": everything.misses, "wrong": everything.wrong}


def main() -> None:
    """Print the rows as JSON or as a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--scenes", type=int, default=SCENES, help="scenes a level, half of them by each sensor")
    parser.add_argument("--train", action="store_true", help="train seeds instead of test seeds")
    parser.add_argument("--failures", action="store_true", help="also each miss and wrong answer with its seed")
    arguments = parser.parse_args()
    tallies, book = measure_all(TRAIN if arguments.train else TEST, arguments.scenes)
    rows = rows_of(tallies, book)
    if arguments.json:
        found = {"failures": failures(tallies)} if arguments.failures else {}
        print(json.dumps({"machine": machine(), "rows": rows} | found))
        return
    for row in rows:
        verdict = {True: "", False: "MISSED", None: "-"}[row["holds"]]
        print(f"{row['name']:52} {row['value']:9} {row['unit']:4} target {row['target']} of {row['of']} {verdict}")
    if arguments.failures:
        for kind, entries in failures(tallies).items():
            for entry in entries.items() if isinstance(entries, dict) else entries:
                print(kind, entry)


if __name__ == "__main__":
    main()
