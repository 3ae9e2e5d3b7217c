"""Of candidates that contradict each other those are there that explain most together."""

from __future__ import annotations

import numpy as np
import pytest

from zsight_core.model import Box
from zsight_core.search.claims import Claim, claimed, consistent, contradict
from zsight_core.solid import solid_of
from zsight_core.transform import from_rpy

CUBE = solid_of(Box((0.05, 0.05, 0.05)))
BAR = solid_of(Box((0.1, 0.05, 0.02)))


def claim(first: int, count: int, worth: float, x: float) -> Claim:
    """A cube x metres along, that explains pixels from the first on."""
    return Claim(CUBE, from_rpy((x, 0, 1.0), (0, 0, 0)), np.arange(first, first + count), worth)


def test_those_apart_are_all_there() -> None:
    assert consistent([claim(0, 10, 5.0, 0.0), claim(20, 10, 50.0, 0.2), claim(40, 10, 1.0, 0.4)]) == [0, 1, 2]
    assert consistent([]) == []


def test_of_two_in_one_room_the_one_of_more_worth_is_there() -> None:
    here, there = claim(0, 10, 5.0, 0.0), claim(20, 10, 6.0, 0.02)
    assert contradict(here, there)
    assert consistent([here, there]) == [1]
    assert consistent([there, here]) == [0]


@pytest.mark.parametrize("common", [4, 6])
def test_no_pixel_shows_two_things(common: int) -> None:
    """Less than half of the pixels may be common: edges are not exact."""
    one, other = claim(0, 10, 10.0, 0.0), claim(10 - common, 10, 9.0, 0.2)
    assert contradict(one, other) == (common > 5)
    assert consistent([one, other]) == ([0] if common > 5 else [0, 1])


def test_a_large_one_does_not_displace_two_that_explain_more_together() -> None:
    large = claim(0, 20, 12.0, 0.1)._replace(solid=BAR)
    small = [claim(0, 12, 8.0, 0.0), claim(12, 12, 9.0, 0.2)]
    assert consistent([large, *small]) == [1, 2]
    assert consistent([large._replace(worth=20.0), *small]) == [0]


def test_what_others_explain_piece_by_piece_is_not_there() -> None:
    """It shares less than half of its pixels with each of them, and more than half with both."""
    parts = [claim(0, 20, 30.0, 0.0), claim(26, 20, 30.0, 0.4)]
    whole = claim(12, 20, 10.0, 0.2)
    assert not any(contradict(whole, part) for part in parts)
    assert consistent([*parts, whole]) == [0, 1]


def test_many_in_one_heap_are_decided() -> None:
    """More than are tried in all ways: the best go first."""
    heap = [claim(8 * k, 12, 100.0 - k, 0.2 * k) for k in range(40)]
    chosen = consistent(heap)
    assert chosen[0] == 0
    assert all(not contradict(heap[a], heap[b]) for a in chosen for b in chosen if a != b)
    assert consistent(heap) == chosen


def test_pixels_are_those_that_show_the_surface() -> None:
    depth = np.full((60, 80), 2.0, np.float32)
    depth[20:40, 30:50] = 0.95
    depth[20:40, 46:] = 0.5  # something in front
    pinhole = (400.0, 400.0, 40.0, 30.0)
    T = from_rpy((0.0, 0.0, 0.975), (0, 0, 0))
    pixels = claimed(depth, pinhole, CUBE.vertices, CUBE.faces, T, 1e-3)
    v, u = np.divmod(pixels, 80)
    assert set(v.tolist()) == set(range(20, 40, 2))
    assert set(u.tolist()) == set(range(30, 46, 2))
    assert (np.diff(pixels) > 0).all()


def test_beyond_the_image_nothing_is_claimed() -> None:
    depth = np.ones((60, 80), np.float32)
    for T in (from_rpy((3.0, 0.0, 1.0), (0, 0, 0)), from_rpy((0.0, 0.0, -1.0), (0, 0, 0))):
        assert len(claimed(depth, (400.0, 400.0, 40.0, 30.0), CUBE.vertices, CUBE.faces, T, 1e-3)) == 0
