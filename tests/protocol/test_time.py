"""Seconds and nanoseconds, as ROS splits them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from zsight_protocol.message import Time


@given(nanoseconds=st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_nanoseconds_come_back(nanoseconds: int) -> None:
    time = Time.from_ns(nanoseconds)
    assert time.ns == nanoseconds
    assert 0 <= time.nanosec < 10**9


def test_before_the_epoch_the_nanoseconds_still_count_forward() -> None:
    assert Time.from_ns(-1) == Time(sec=-1, nanosec=999_999_999)


@pytest.mark.parametrize("nanoseconds", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_a_time_that_ros_cannot_hold_is_refused(nanoseconds: int) -> None:
    with pytest.raises(ValidationError, match="sec"):
        Time.from_ns(nanoseconds)


def test_now_is_later_than_this_test_was_written() -> None:
    assert Time.now().sec > 1_700_000_000
