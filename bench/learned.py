"""What a learned finder could add: how often geometric proposals miss, and what a small classifier makes of segments.

A proposer can help only where no hypothesis is near the truth. A classifier of segments could spare most types a look;
the one here is a nearest-neighbour vote over descriptors of segments, learned from simulated scenes in seconds, without
a network. Train and test scenes have seeds apart, and the test is seen by the other noise model.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from zsight.catalogue.type_files import load, shipped_folder
from zsight_core import find, scene
from zsight_core.model import ObjectModel, Surface
from zsight_core.search.clues import clues_of
from zsight_core.search.recognise import hypotheses
from zsight_core.simulation.camera import expose
from zsight_core.simulation.kinect import Kinect
from zsight_core.simulation.random_scenes import Level, RandomScene, draw_scene
from zsight_core.simulation.time_of_flight import TimeOfFlight

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.scene import Scene, Segment
    from zsight_core.simulation.camera import Noise
    from zsight_core.simulation.random_scenes import Placed

LEVELS: tuple[Level, ...] = ("+3", "+7", "+11 touching", "stacked")
TRAIN, TEST = 5000, 9000
NEAR = 0.012
"""Metres from the true middle within which a hypothesis can be refined to it."""

NEIGHBOURS = 7


def seen_of(drawn: RandomScene, noise: Noise) -> Scene:
    """The scene stage of a drawn scene."""
    points = expose(drawn.view, drawn.camera.pinhole, noise, drawn.seed)
    return scene.understand(points, T_world_camera=drawn.T_world_camera)


def descriptor(segment: Segment, seen: Scene) -> NDArray[np.float64]:
    """What a segment looks like, whichever way it is turned: sizes, heights, how level and how round it is (20,)."""
    cells = seen.cells
    mine = np.repeat(seen.owner, np.diff(cells.start)) == segment.label
    points, normals = cells.points[mine], cells.normals[mine]
    centred = points[:, :2] - points[:, :2].mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    along = np.ptp(centred @ axes, axis=0)
    z = points[:, 2]
    radius = np.linalg.norm(centred, axis=1)
    shares = np.histogram(z / max(float(z.max()), 1e-3), 6, (0, 1))[0] / len(z)
    rounds = np.histogram(radius / max(float(radius.max()), 1e-3), 6, (0, 1))[0] / len(z)
    up = np.histogram(normals[:, 2], 5, (0, 1))[0] / len(z)
    return np.concatenate([[20 * along.max(), 20 * along.min(), 20 * z.max()], shares, rounds, up])


def owner_of(segment: Segment, drawn: RandomScene) -> Placed | None:
    """The object whose middle is nearest to that of a segment, where that is likely it."""
    middle = (drawn.T_world_camera @ segment.T_camera_box)[:3, 3]
    if not drawn.objects or segment.support != 0:
        return None
    gaps = [float(np.linalg.norm(thing.T_world_model[:2, 3] - middle[:2])) for thing in drawn.objects]
    return drawn.objects[int(np.argmin(gaps))] if min(gaps) < 0.03 else None


def samples(first: int, scenes: int, models: list[ObjectModel], noise: Noise) -> tuple[NDArray[np.float64], list[str]]:
    """Descriptors and types of the segments of some scenes."""
    rows, names = [], []
    for seed in range(first, first + scenes):
        drawn = draw_scene(LEVELS[seed % 2], seed, models)
        seen = seen_of(drawn, noise)
        for segment in seen.segments:
            owner = owner_of(segment, drawn)
            if owner is not None:
                rows.append(descriptor(segment, seen))
                names.append(owner.model.name)
    return np.array(rows), names


def ranks(scenes: int, models: list[ObjectModel]) -> list[int]:
    """Place of the true type in the vote of the neighbours, of each segment of the test scenes; from 0."""
    known, names = samples(TRAIN, 3 * scenes, models, Kinect())
    asked, truth = samples(TEST, scenes, models, TimeOfFlight())
    kinds = sorted({model.name for model in models})
    gaps, nearest = cKDTree(known).query(asked, k=NEIGHBOURS)
    places = []
    for row, near, true in zip(gaps, nearest, truth, strict=True):
        votes = dict.fromkeys(kinds, 0.0)
        for gap, k in zip(row, near, strict=True):
            votes[names[k]] += 1 / (gap + 0.01)
        places.append(sorted(kinds, key=lambda kind: (-votes[kind], kind)).index(true))
    return places


def proposed(scenes: int, models: list[ObjectModel], level: Level) -> tuple[int, int]:
    """Objects seen at least half that some hypothesis is near to, and all of them."""
    near, total = 0, 0
    for seed in range(TEST, TEST + scenes):
        drawn = draw_scene(level, seed, models)
        seen = seen_of(drawn, Kinect() if seed % 2 else TimeOfFlight())
        clues = clues_of(seen)
        frames = [drawn.T_world_camera @ s.T_camera_support for s in seen.supports]
        for thing in drawn.objects:
            if thing.visible < 0.5 or thing.truncated:
                continue
            total += 1
            guesses = hypotheses(thing.model.shape, clues)
            middles = [(frames[g.support] @ g.T_support_model)[:3, 3] for g in guesses]
            gaps = [float(np.linalg.norm(middle - thing.T_world_model[:3, 3])) for middle in middles]
            near += bool(gaps) and min(gaps) < NEAR
    return near, total


def run(scenes: int = 12) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them."""
    find.warm_up()
    models = [m for m in load(shipped_folder()).models() if not isinstance(m.shape, Surface)]
    rows = []
    for level in LEVELS:
        near, total = proposed(scenes, models, level)
        rows.append(_row(f"learned proposals near the truth {level}", near / max(total, 1), total))
    places = ranks(scenes, models)
    for most in (1, 3, 5):
        share = float(np.mean(np.array(places) < most))
        rows.append(_row(f"learned true type among the first {most} of {len(models)}", share, len(places)))
    return rows


def _row(name: str, value: float, of: int) -> dict[str, Any]:
    row: dict[str, Any] = {"name": name, "value": round(value, 4), "unit": "", "peer": None, "peer_value": None}
    return row | {"ratio": None, "target": None, "holds": None, "of": of}


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=12, help="test scenes a level")
    for row in run(parser.parse_args().scenes):
        print(f"{row['name']:48} {row['value']:8} of {row['of']}")


if __name__ == "__main__":
    main()
