"""Oriented bits: the rim of a level top faces away from it, whichever way it runs through the image."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from tests.core.book_scene import COKE_CAN, T_WORLD_CAMERA, TABLE_HEIGHT, TOY_BLOCK, at, cloud

from zsight_core.scene import understand
from zsight_core.search.bits import RIM
from zsight_core.search.clues import clues_of
from zsight_core.search.model_bits import model_bits
from zsight_core.solid import Solid, solid_of

pytestmark = pytest.mark.usefixtures("warm_kernels")


@pytest.mark.parametrize("degrees", range(0, 90, 9))
def test_the_rims_of_a_block_face_away_from_its_sides(degrees: float) -> None:
    turned = np.radians(degrees)
    points = cloud((TOY_BLOCK, at(0.5, -0.3, TABLE_HEIGHT + 0.0175, turned)))
    scene = understand(points, T_world_camera=T_WORLD_CAMERA)
    clues = clues_of(scene)
    R_world_support = (T_WORLD_CAMERA @ clues.stacked[0])[:3, :3]
    side = R_world_support.T @ (np.cos(turned), np.sin(turned), 0.0)
    rims = clues.bits.azimuth[clues.bits.kind == RIM]
    off = np.degrees((rims - np.arctan2(side[1], side[0]) + np.pi / 4) % (np.pi / 2) - np.pi / 4)
    assert len(rims) > 20
    assert abs(np.median(off)) < 4
    assert np.percentile(abs(off), 75) < 10  # those at corners face between two sides


def test_every_second_sample_of_a_model_is_spread_over_it_too() -> None:
    """A can that is seen from above shows nothing but its top."""
    bits = model_bits(solid_of(COKE_CAN.shape), np.eye(3), is_round=True)
    for half in (bits.samples[:, ::2], bits.samples[:, 1::2]):
        assert (half[5] > 0.9).sum() >= 4


@pytest.mark.parametrize(("corners", "order"), [(3, 3), (4, 4), (5, 1), (6, 3), (8, 4)])
def test_turns_that_put_a_prism_onto_itself(corners: int, order: int) -> None:
    around = np.arange(corners) * 2 * np.pi / corners + 0.3
    ring = np.stack([0.1 * np.cos(around), 0.1 * np.sin(around)], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(corners, z)]) for z in (0.05, -0.05)])
    faces = ConvexHull(vertices).simplices.astype(np.int32)
    solid = Solid(vertices, faces, np.empty((0, 4), np.int32))
    assert model_bits(solid, np.eye(3), is_round=False).order == order
    vertices[0, 0] += 0.001
    assert model_bits(solid, np.eye(3), is_round=False).order == 1
