"""A candidate that is found beside its place gets there, and stays there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.core import book_scene as book

from zsight_core.files.mesh_file import read
from zsight_core.model import ObjectModel
from zsight_core.scene import go_on, understand
from zsight_core.search import candidates
from zsight_core.search.candidates import Candidate, Candidates
from zsight_core.search.clues import Hypothesis
from zsight_core.search.verify import Evidence
from zsight_core.simulation.kinect import Kinect
from zsight_core.transform import from_rpy, inverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

BRACKET = ObjectModel("l_bracket", read(Path(__file__).parents[2] / "services/zsight/types/l_bracket.stl"))
GOOD = Evidence(
    pixels=2000, match=1950, through=0, proud=0, hidden=0, unknown=50, beyond=0, edge=50, goes_on=0, nothing=0,
    edge_hidden=2, sunk=0.0002, raised=0.0002, offset=0.6, worst_side=0.05, shift=0.0001, bias=0.1,
)  # fmt: skip


@pytest.mark.parametrize("along", [-0.03, 0.025, 0.03])
def test_what_is_proposed_too_far_along_slides_to_its_place(along: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Farther than an outline is looked for: a long block's sides fit as well there."""
    points = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK), noise=Kinect(), seed=3)
    scene = understand(points, T_world_camera=book.T_WORLD_CAMERA)
    search = Candidates(scene, go_on)
    true = inverse(search.clues.frames[0]) @ inverse(book.T_WORLD_CAMERA) @ book.T_WORLD_BLOCK
    beside = Hypothesis(true @ from_rpy((0, along, 0), (0, 0, 0)), 0.0, 0, turns=True)
    monkeypatch.setattr(candidates, "hypotheses", lambda *_: [beside])
    trials, _ = search.of(book.TOY_BLOCK)
    assert len(trials.kept) == 1
    assert np.linalg.norm(trials.kept[0].hypothesis.T_support_model[:3, 3] - true[:3, 3]) < 0.002
    assert trials.kept[0].probability > 0.95


@pytest.mark.parametrize(
    ("y", "mirrored"),
    [(-0.60, from_rpy((0, 0, -0.052), (np.pi, 0, 0))), (-0.62, from_rpy((-0.072, 0, 0), (0, 0, np.pi)))],
    ids=["about the long leg", "about the short leg"],
)
def test_what_explains_the_same_pixels_is_another_way_to_be_there(
    y: float, mirrored: NDArray[np.float64], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bracket at the image's border: proposed is the same leg with the other one, mirrored, out of sight."""
    T = from_rpy((0.5, y, book.TABLE_HEIGHT + 0.02), (-np.pi / 2, 0, 0))
    points = book.cloud((BRACKET, T), noise=Kinect(), seed=1)
    search = Candidates(understand(points, T_world_camera=book.T_WORLD_CAMERA), go_on)
    true = inverse(search.clues.frames[0]) @ inverse(book.T_WORLD_CAMERA) @ T
    monkeypatch.setattr(candidates, "hypotheses", lambda *_: [Hypothesis(true @ mirrored, 0.0, 0, turns=True)])
    (found,) = search.of(BRACKET)[0].kept
    assert np.linalg.norm(found.hypothesis.T_support_model[:3, 3] - true[:3, 3]) < 0.003


def test_one_more_fit_may_not_lead_to_a_worse_place() -> None:
    def fitted(x: float, logit: float) -> Candidate:
        T: NDArray[np.float64] = from_rpy((x, 0, 0), (0, 0, 0))
        return Candidate(Hypothesis(T, 0.0, 0, turns=True), GOOD, np.eye(4), 0.9, logit)

    first = fitted(0.0, 5.0)
    better_here, worse_here, better_there, worse_there = (fitted(x, y) for x in (0.001, 0.02) for y in (6.0, 4.0))
    assert candidates.not_astray(first, better_here) is better_here
    assert candidates.not_astray(first, worse_here) is worse_here  # more pixels were looked at
    assert candidates.not_astray(first, better_there) is better_there
    assert candidates.not_astray(first, worse_there) is first
