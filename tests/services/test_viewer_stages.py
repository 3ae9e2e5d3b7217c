"""What the stages make of a cloud with certain settings, on truth that is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight import finder, planes, voxel
from zsight.viewer.stages import STAGES, Seen, StageResult
from zsight_core.points import from_xyz, xyz
from zsight_core.transform import transform_xyz

pytestmark = pytest.mark.usefixtures("warm_kernels")

POINTS = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK))
WORLD = transform_xyz(book.T_WORLD_CAMERA, xyz(POINTS).astype(np.float64))
ON_TABLE = (np.abs(WORLD[..., 2] - book.TABLE_HEIGHT) < 0.001) & (np.abs(WORLD[..., :2] - (0.9, -0.3)) < 0.1).all(-1)
PATCH = POINTS[ON_TABLE][np.newaxis]
SEEN = Seen(POINTS, PATCH, book.T_WORLD_CAMERA)


def result(service: str, seen: Seen = SEEN, **settings: Any) -> StageResult:
    kinds = {"voxel": voxel.Settings, "planes": planes.Settings, "finder": finder.Settings}
    made = STAGES[service](seen, kinds[service](**settings).model_dump())
    assert isinstance(made, StageResult), made
    return made


def counts(made: StageResult) -> dict[str, int]:
    return {fate.name: fate.count for fate in made.fates}


def drawn(made: StageResult, name: str) -> int:
    (colour,) = (fate.colour for fate in made.fates if fate.name == name)
    return int((made.colours == np.array(colour)).all(axis=1).sum())


def test_every_point_of_a_cloud_is_counted_once() -> None:
    told = counts(result("finder"))
    assert sum(told.values()) == POINTS.size
    assert told["without depth"] == int((~np.isfinite(xyz(POINTS)[..., 2])).sum())
    voxels = counts(result("voxel", leaf=0.02))
    assert voxels["went into them"] + voxels["without depth"] == POINTS.size
    assert 0 < voxels["averaged points"] < voxels["went into them"] / 4


def test_what_is_drawn_is_what_is_counted() -> None:
    made = result("finder")
    for fate in made.fates:
        assert fate.colour is None or drawn(made, fate.name) == fate.count
    assert len(made.edges) % 12 == 0
    assert made.words == f"2 surfaces, {len(made.edges) // 12} things"


def test_a_limit_of_the_finder_moves_points_from_one_fate_to_another() -> None:
    usual, strict = counts(result("finder")), counts(result("finder", largest=0.1))
    assert usual["of a thing"] > 500
    assert (usual["of a thing too large (largest)"], strict["of a thing"]) == (0, 0)
    assert strict["of a thing too large (largest)"] >= usual["of a thing"]  # and specks beside them


def test_planes_tell_what_lies_in_the_plane_beside_it_and_above_it() -> None:
    usual = result("planes")
    assert counts(usual)["in the plane"] == pytest.approx(
        (np.abs(WORLD[..., 2] - book.TABLE_HEIGHT) < 0.01).sum(), rel=0.01
    )
    assert counts(usual)["of the patch, farther from the plane than the tolerance"] == 0
    above = counts(result("planes", above=True, above_high=0.02))
    assert above["above the plane"] > 50
    assert above["higher than above_high"] > 500  # the block is 35 mm high
    assert counts(result("planes", above=True))["higher than above_high"] == 0


def test_planes_tell_what_is_not_connected_to_the_patch() -> None:
    beside = np.abs(WORLD[..., 0] - 0.6) > 0.03
    parted = Seen(POINTS[beside][np.newaxis], PATCH, None)
    told = counts(result("planes", parted, connected=True, gap=0.02))
    assert told["in the plane, not connected to the patch"] > 5000
    assert (
        told["in the plane"] + told["in the plane, not connected to the patch"]
        == counts(result("planes", parted))["in the plane"]
    )


def test_strays_of_a_patch_are_counted() -> None:
    lifted = xyz(PATCH).copy()
    lifted[0, ::10] += np.float32(0.2)
    strays = counts(result("planes", Seen(POINTS, from_xyz(lifted), None)))
    assert strays["of the patch, farther from the plane than the tolerance"] == len(lifted[0, ::10])


def test_what_is_missing_is_said() -> None:
    assert "Select a rectangle first" in str(STAGES["planes"](Seen(POINTS, None, None), planes.Settings().model_dump()))
    measured = int(np.isfinite(xyz(POINTS)[..., 2]).sum())
    camera = STAGES["camera"](SEEN, {})
    assert isinstance(camera, StageResult)
    assert counts(camera) == {"measured": measured, "without depth": POINTS.size - measured}
