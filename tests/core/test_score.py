"""Whatever speaks against an object makes it less probable, and a lookalike is told from it."""

from __future__ import annotations

import pytest
from tests.core import book_scene as book

from zsight_core import find as finder
from zsight_core.model import Box, Cylinder, ObjectModel, Shape, Sphere
from zsight_core.search.score import logit_of, probability_of
from zsight_core.search.verify import Evidence
from zsight_core.simulation.kinect import Kinect

GOOD = Evidence(
    pixels=2000, match=1950, through=0, proud=0, hidden=0, unknown=50, beyond=0, edge=50, goes_on=0, nothing=0,
    edge_hidden=2, sunk=0.0002, raised=0.0002, offset=0.6, worst_side=0.05, shift=0.0001, bias=0.1,
)  # fmt: skip


def test_a_good_fit_is_probable() -> None:
    assert probability_of(GOOD) > 0.95


@pytest.mark.parametrize(
    "worse",
    [
        {"through": 500.0},
        {"goes_on": 30.0},
        {"nothing": 30.0},
        {"sunk": 0.004},
        {"raised": 0.004},
        {"offset": 2.5},
        {"bias": 2.0, "offset": 2.0},
        {"edge_hidden": 200.0},
        {"worst_side": 0.9},
        {"shift": 0.004},
        {"pixels": 400, "match": 390, "unknown": 10},
    ],
)
def test_what_speaks_against_it_makes_it_less_probable(worse: dict[str, float]) -> None:
    assert logit_of(GOOD._replace(**worse)) < logit_of(GOOD) - 0.2


def test_nothing_seen_is_nothing_told() -> None:
    assert probability_of(GOOD._replace(match=5.0)) < 1e-6


@pytest.mark.parametrize(
    ("asked", "standing", "height"),
    [
        (Box((0.05, 0.05, 0.05)), Box((0.0575, 0.0575, 0.0575)), 0.0575),
        (Cylinder(0.066, 0.122), Cylinder(0.0561, 0.1037), 0.1037),
        (Cylinder(0.066, 0.122), Cylinder(0.0759, 0.1403), 0.1403),
        (Sphere(0.065), Sphere(0.0553), 0.0553),
        (Sphere(0.065), Box((0.065, 0.065, 0.065)), 0.065),
        (Cylinder(0.066, 0.122), Box((0.066, 0.066, 0.122)), 0.122),
    ],
)
def test_lookalikes_are_not_found(asked: Shape, standing: Shape, height: float) -> None:
    T = book.at(0.6, -0.3, book.TABLE_HEIGHT + height / 2, 0.3)
    points = book.cloud((ObjectModel("standing", standing), T), noise=Kinect(), seed=5)
    assert finder.find(points, [ObjectModel("asked", asked)], T_world_camera=book.T_WORLD_CAMERA).detections == ()
