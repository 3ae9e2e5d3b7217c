"""The transform buffer obeys the laws of a tree of frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsight import limits
from zsight.convert import stamped
from zsight.transforms import TransformBuffer, TransformUnknown
from zsight_core.transform import from_rpy, inverse
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Time

SECOND = 10**9


@st.composite
def trees(draw: st.DrawFn) -> tuple[TransformBuffer, dict[str, np.ndarray]]:
    """A buffer of a random tree, told in random order, and where each frame truly is in the root."""
    count = draw(st.integers(2, 7))
    T_root_frame = {"f0": np.eye(4)}
    entries = []
    numbers = st.floats(-3, 3)
    for number in range(1, count):
        parent = f"f{draw(st.integers(0, number - 1))}"
        T = from_rpy([draw(numbers) for _ in range(3)], [draw(numbers) for _ in range(3)])
        T_root_frame[f"f{number}"] = T_root_frame[parent] @ T
        entries.append(stamped(T, parent, f"f{number}", Time()))
    buffer = TransformBuffer()
    for entry in draw(st.permutations(entries)):
        buffer.put(TransformList(transforms=(entry,)), static=True)
    return buffer, T_root_frame


@given(trees(), st.data())
def test_a_lookup_is_the_chain_between_two_frames(
    tree: tuple[TransformBuffer, dict[str, np.ndarray]], data: st.DataObject
) -> None:
    buffer, T_root_frame = tree
    frames = st.sampled_from(sorted(T_root_frame))
    a, b, c = (data.draw(frames) for _ in range(3))
    expected = inverse(T_root_frame[a]) @ T_root_frame[b]
    np.testing.assert_allclose(buffer.lookup(a, b), expected, atol=1e-9)
    np.testing.assert_allclose(buffer.lookup(a, b) @ buffer.lookup(b, a), np.eye(4), atol=1e-9)
    np.testing.assert_allclose(buffer.lookup(a, b) @ buffer.lookup(b, c), buffer.lookup(a, c), atol=1e-9)
    assert buffer.root_of(a) == "f0"
    assert buffer.frames() == set(T_root_frame)


def at(seconds: float, x: float, *, parent: str = "world", child: str = "hand", yaw: float = 0.0) -> TransformList:
    T = from_rpy((x, 0, 0), (0, 0, yaw))
    return TransformList(transforms=(stamped(T, parent, child, Time.from_ns(round(seconds * SECOND))),))


def test_a_frame_is_itself() -> None:
    buffer = TransformBuffer()
    np.testing.assert_array_equal(buffer.lookup("camera", "camera"), np.eye(4))
    assert buffer.root_of("camera") == "camera"


def test_a_newer_static_transform_replaces_the_older_one() -> None:
    buffer = TransformBuffer()
    buffer.put(at(0, 1.0), static=True)
    buffer.put(at(0, 2.0, parent="table"), static=True)
    assert buffer.lookup("table", "hand")[0, 3] == 2.0
    with pytest.raises(TransformUnknown):
        buffer.lookup("world", "hand")


def test_a_missing_link_is_named() -> None:
    buffer = TransformBuffer()
    buffer.put(at(0, 1.0, parent="world", child="kinect"), static=True)
    buffer.put(at(0, 1.0, parent="arm", child="hand"), static=True)
    with pytest.raises(
        TransformUnknown, match=r"from hand to kinect: hand leads up to arm, kinect to world; known fra"
    ):
        buffer.lookup("kinect", "hand")
    with pytest.raises(TransformUnknown, match="elsewhere"):
        buffer.lookup("elsewhere", "hand")


def test_the_links_of_a_lookup_are_told() -> None:
    buffer = TransformBuffer()
    buffer.put(at(0, 1.0, parent="world", child="kinect"), static=True)
    buffer.put(at(0, 1.0, parent="world", child="arm"), static=True)
    buffer.put(at(0, 1.0, parent="arm", child="hand"))
    through = [("world", "kinect", True), ("world", "arm", True), ("arm", "hand", False)]
    assert buffer.links("hand", "kinect") == through
    assert buffer.links("kinect", "hand") == through[::-1]
    assert buffer.links("world", "world") == buffer.links("elsewhere", "hand") == []


def test_a_ring_of_frames_does_not_hang() -> None:
    buffer = TransformBuffer()
    for parent, child in (("a", "b"), ("b", "c"), ("c", "a")):
        buffer.put(at(0, 1.0, parent=parent, child=child), static=True)
    assert np.isfinite(buffer.lookup("a", "c")).all()
    with pytest.raises(TransformUnknown):
        buffer.lookup("elsewhere", "a")


@given(st.floats(0, 1), st.permutations(range(5)))
def test_between_two_times_a_frame_moves_evenly(fraction: float, order: list[int]) -> None:
    buffer = TransformBuffer()
    for second in order:
        buffer.put(at(second, second * 0.5, yaw=second * 0.2))
    T = buffer.lookup("world", "hand", round((2 + fraction) * SECOND))
    np.testing.assert_allclose(T, from_rpy(((2 + fraction) * 0.5, 0, 0), (0, 0, (2 + fraction) * 0.2)), atol=1e-6)


def test_no_time_asks_for_the_newest() -> None:
    buffer = TransformBuffer()
    for seconds in (1, 3, 2):
        buffer.put(at(seconds, seconds))
    assert buffer.lookup("world", "hand")[0, 3] == 3.0


@pytest.mark.parametrize(("seconds", "side"), [(0.5, "0.500 s before the oldest"), (3.25, "0.250 s after the newest")])
def test_a_time_that_nobody_told_of_is_refused(seconds: float, side: str) -> None:
    buffer = TransformBuffer()
    buffer.put(at(1, 1.0))
    buffer.put(at(3, 3.0))
    with pytest.raises(TransformUnknown, match=side):
        buffer.lookup("world", "hand", round(seconds * SECOND))


def test_the_past_is_forgotten_after_ten_seconds() -> None:
    buffer = TransformBuffer()
    for seconds in range(0, 30, 2):
        buffer.put(at(seconds, seconds))
    assert buffer.lookup("world", "hand", 20 * SECOND)[0, 3] == 20.0
    with pytest.raises(TransformUnknown):
        buffer.lookup("world", "hand", 16 * SECOND)


def test_the_later_one_of_two_of_the_same_time_counts_and_the_other_is_forgotten() -> None:
    buffer = TransformBuffer()
    for x in range(100):
        buffer.put(at(1, x))
        buffer.put(at(2, -x))
    assert [buffer.lookup("world", "hand", second * SECOND)[0, 3] for second in (1, 2)] == [99.0, -99.0]
    assert list(buffer._links["hand"].times) == [SECOND, 2 * SECOND]


def test_so_many_times_are_remembered_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "TRANSFORMS", 3)
    buffer = TransformBuffer()
    for number in range(5):
        buffer.put(at(number / 1000, number))
    assert list(buffer._links["hand"].times) == [2_000_000, 3_000_000, 4_000_000]
    assert buffer.lookup("world", "hand", 2_500_000)[0, 3] == pytest.approx(2.5)


def test_so_many_frames_are_known_and_no_more(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(limits, "FRAMES", 2)
    buffer = TransformBuffer()
    for number in range(3):
        buffer.put(at(0, number, child=f"f{number}"), static=bool(number % 2))
    buffer.put(at(1, 7.0, child="f0"))
    assert buffer.frames() == {"world", "f0", "f1"}
    assert buffer.lookup("world", "f0")[0, 3] == 7.0
    assert "frame f2 is left out: 2 frames are known already" in caplog.text


def test_a_static_transform_holds_at_any_time() -> None:
    buffer = TransformBuffer()
    buffer.put(at(5, 1.0), static=True)
    assert buffer.lookup("world", "hand", 1)[0, 3] == 1.0


def test_what_was_ahead_is_forgotten_when_a_recording_goes_back() -> None:
    buffer = TransformBuffer()
    for seconds in (20, 21, 30):
        buffer.put(at(seconds, seconds))
    buffer.put(at(22, 22.0))
    with pytest.raises(TransformUnknown, match="after the newest"):
        buffer.lookup("world", "hand", 25 * SECOND)
    assert buffer.lookup("world", "hand", 21 * SECOND)[0, 3] == 21.0
