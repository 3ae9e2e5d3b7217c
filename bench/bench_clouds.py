"""The clouds that measurements run on: three real ones, and a synthetic 1280 x 720."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsight_core.files import pcd
from zsight_core.pack_fields import to_packed
from zsight_core.plane import Plane, frame_on_plane, ransac_plane
from zsight_core.points import from_xyz
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.points import Points

DATA = Path(os.environ.get("ZSIGHT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
TABLE = 0.775
"""Height, metres, at which the dominant plane of each cloud is placed in the world."""


@dataclass(frozen=True)
class BenchCloud:
    """A cloud in 16-byte points, its file as binary PCD, its dominant plane and a world in which that is the table."""

    name: str
    points: Points
    file: Path
    plane: Plane
    T_world_camera: NDArray[np.float64]


def clouds(scratch: Path) -> list[BenchCloud]:
    """Those of the recordings that are there, and the synthetic one."""
    recordings = {
        "mosd": DATA / "mosd_learn" / "learn0.pcd",
        "milk": DATA / "pcl" / "milk_cartoon_all_small_clorox.pcd",
        "mug": DATA / "pcl" / "table_scene_mug_stereo_textured.pcd",
    }
    found = [
        prepare(name, to_packed(pcd.read(path).points), scratch) for name, path in recordings.items() if path.exists()
    ]
    return [*found, prepare("synthetic 1280x720", synthetic(), scratch)]


def prepare(name: str, points: Points, scratch: Path) -> BenchCloud:
    """Write the cloud where PCL can read it, and find its table."""
    file = scratch / f"{name.replace(' ', '_')}.pcd"
    pcd.write(file, points)
    plane = ransac_plane(points, 0.01).plane
    T = inverse(frame_on_plane(plane, plane.normal * plane.distance))
    T[2, 3] += TABLE
    return BenchCloud(name, points, file, plane, T)


def synthetic(width: int = 1280, height: int = 720, seed: int = 0) -> Points:
    """A table with boxes before a wall, seen by a pinhole camera, with noise that grows with the square of depth."""
    rng = np.random.default_rng(seed)
    focal = 0.82 * width
    v, u = np.mgrid[0:height, 0:width]
    rays = np.stack([(u - width / 2 + 0.5) / focal, (v - height / 2 + 0.5) / focal, np.ones((height, width))], axis=-1)
    down = np.array([0.0, np.sin(0.9), np.cos(0.9)]) @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]).T
    up = -np.array([0.0, np.cos(0.7), np.sin(0.7)]) if down is not None else down
    depth = np.full((height, width), 3.0)
    colour = np.full((height, width, 3), 120)
    for rise, low, high, shade in [
        (0.0, -0.6, 0.6, 200),
        (0.08, -0.3, -0.1, 40),
        (0.15, 0.05, 0.2, 90),
        (0.03, 0.3, 0.5, 230),
    ]:
        z = (rise - 0.8) / (rays @ up)
        x, far = rays[..., 0] * z, rays @ np.cross(up, [1.0, 0, 0]) * z
        hit = (z > 0) & (z < depth) & (x > low) & (x < high) & (np.abs(far + 0.9) < (0.5 if rise == 0 else 0.1))
        depth[hit], colour[hit] = z[hit], shade
    depth += rng.normal(0, 1.2e-3, depth.shape) * depth**2
    depth[rng.random(depth.shape) < 0.03] = np.nan
    depth[:, : width // 20] = np.nan
    colour = np.clip(colour + rng.integers(-9, 10, colour.shape), 0, 255)
    return from_xyz(rays * depth[..., np.newaxis], colour.astype(np.uint8))
