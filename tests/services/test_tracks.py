"""Names stay with objects by type and place."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from zsight.finding.tracks import REACH, Tracks


def at(*places: tuple[float, float]) -> np.ndarray:
    return np.array([[x, y, 0.0] for x, y in places]).reshape(-1, 3)


def test_the_order_of_an_answer_does_not_matter() -> None:
    tracks = Tracks()
    assert tracks.follow(["cube", "cube", "can"], at((0, 0), (1, 0), (2, 0))) == ["cube-1", "cube-2", "can-1"]
    assert tracks.follow(["can", "cube", "cube"], at((2, 0), (1, 0), (0, 0))) == ["can-1", "cube-2", "cube-1"]


def test_two_that_move_together_keep_their_names() -> None:
    tracks = Tracks()
    tracks.follow(["cube", "cube"], at((0, 0), (0.1, 0)))
    assert tracks.follow(["cube", "cube"], at((0.06, 0), (0.16, 0))) == ["cube-1", "cube-2"]


def test_what_was_not_seen_for_a_while_is_known_again() -> None:
    tracks = Tracks()
    tracks.follow(["cube", "cube"], at((0, 0), (1, 0)))
    assert tracks.follow(["cube"], at((1, 0))) == ["cube-2"]
    assert tracks.follow([], at()) == []
    assert tracks.follow(["cube"], at((0, 0))) == ["cube-1"]


def test_what_is_far_or_of_another_type_is_new() -> None:
    tracks = Tracks()
    tracks.follow(["cube"], at((0, 0)))
    assert tracks.follow(["can"], at((0, 0))) == ["can-1"]
    assert tracks.follow(["cube"], at((REACH * 1.01, 0))) == ["cube-2"]


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 8))
def test_things_apart_keep_their_names_whatever_their_order(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    places = np.column_stack([np.arange(count) * 4 * REACH, np.zeros((count, 2))])
    tracks = Tracks()
    names = tracks.follow(["cube"] * count, places)
    order = generator.permutation(count)
    moved = places[order] + generator.uniform(-REACH / 2, REACH / 2, (count, 3))
    assert tracks.follow(["cube"] * count, moved) == [names[k] for k in order]
