"""The fraction that a client sees rises from nothing to the whole, whatever the stages tell of themselves."""

from __future__ import annotations

import pytest

from zsight.finding.find_progress import FindProgress


def told_by(stages: list[tuple[str, float]], types: int = 1) -> list[float]:
    told: list[float] = []
    progress = FindProgress(lambda _, fraction: told.append(fraction), types)
    for stage, fraction in stages:
        progress(stage, fraction)
    return told


def test_stages_add_up() -> None:
    stages = [("view", 0.0), ("segments", 0.8), ("search", 0.0), ("propose", 0.5), ("look", 0.5), ("refine", 1.0)]
    assert told_by(stages) == pytest.approx([0.0, 0.08, 0.1, 0.28, 0.505, 1.0])


def test_each_of_several_types_has_its_share() -> None:
    stages = [("search", 0.0), ("refine", 1.0), ("search", 0.5), ("propose", 1.0), ("refine", 1.0)]
    assert told_by(stages, types=2) == pytest.approx([0.1, 0.55, 0.55, 0.73, 1.0])


def test_it_never_goes_back() -> None:
    # A rival's search begins anew.
    assert told_by([("refine", 0.5), ("propose", 0.1), ("scene", 0.0)]) == pytest.approx([0.775, 0.775, 0.775])
