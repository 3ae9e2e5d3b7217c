"""A message with other values in some of its fields."""

from __future__ import annotations

import pytest
from hypothesis import given
from pydantic import ValidationError
from tests.protocol.legal_messages import clouds, messages

from zsight_protocol.codec import decode, encode
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import PointCloud2


@given(cloud=clouds(), header=messages(Header))
def test_all_but_what_is_named_stays_and_the_first_is_not_touched(cloud: PointCloud2, header: Header) -> None:
    before = encode(cloud)
    other = cloud.but(header=header)
    assert other == cloud.model_copy(update={"header": header})
    assert type(other) is PointCloud2
    assert decode(PointCloud2, encode(other)) == other
    assert encode(cloud) == before


def test_it_is_read_only_as_any_message() -> None:
    time = Time(sec=1, nanosec=2).but(nanosec=3)
    same = Time(sec=1, nanosec=3)
    assert (time, hash(time), repr(time)) == (same, hash(same), repr(same))
    with pytest.raises(ValidationError, match="frozen"):
        time.sec = 5  # type: ignore[misc]  # that is the point
