"""The twin in memory matches keys as Zenoh does."""

from __future__ import annotations

import zenoh
from hypothesis import example, given, settings
from hypothesis import strategies as st

from zsight.bus.memory_link import matches

CHUNKS = st.sampled_from(["a", "b", "@a", "@b", "*", "**"])


def _canonical(chunks: list[str]) -> str:
    """Zenoh takes no ``**`` beside another wildcard that it swallows: let it write the expression itself."""
    return str(zenoh.KeyExpr.autocanonize("/".join(chunks)))


EXPRESSIONS = st.lists(CHUNKS, min_size=1, max_size=5).map(_canonical)


@settings(max_examples=500)
@given(EXPRESSIONS, EXPRESSIONS)
@example("**", "@a")
@example("**", "**/@a")
@example("**/@a", "@a")
@example("a/**/b", "a/b")
@example("*/**", "a")
@example("@a/*", "@a/@b")
def test_expressions_meet_as_in_zenoh(a: str, b: str) -> None:
    expected = zenoh.KeyExpr(a).intersects(zenoh.KeyExpr(b))
    assert matches(a, b) is expected
    assert matches(b, a) is expected
