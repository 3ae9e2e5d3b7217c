"""Keys become topics that ROS allows, and come back whole."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zsight.recording.topic_name import key_of, topic_of

LEGAL = re.compile(r"(/[A-Za-z_](?:_?[A-Za-z0-9])*_?)+")  # no token begins with a digit, no underscore repeats

chunks = st.text(st.characters(exclude_characters="/"), min_size=1, max_size=12) | st.from_regex(
    r"[a-z0-9_@][a-z0-9_.\-]{0,12}", fullmatch=True
)


@given(st.lists(chunks, min_size=1, max_size=5).map("/".join))
def test_every_key_comes_back_from_a_legal_topic(key: str) -> None:
    topic = topic_of(key)
    assert key_of(topic) == key
    assert LEGAL.fullmatch(topic), topic


@pytest.mark.parametrize(
    ("key", "topic"),
    [
        ("zsight/kinect/points", "/zsight/kinect/points"),
        ("zsight/@health/desk-1/x.y", "/zsight/Ahealth/deskD1/xPy"),
        ("a__b/1/Å", "/a_Ub/N1/Xc5X"),
    ],
)
def test_what_topics_look_like(key: str, topic: str) -> None:
    assert topic_of(key) == topic


@given(st.lists(chunks, min_size=2, max_size=2, unique=True))
def test_two_keys_never_share_a_topic(keys: list[str]) -> None:
    assert topic_of(keys[0]) != topic_of(keys[1])
