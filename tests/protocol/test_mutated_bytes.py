"""Whatever bytes arrive, decoding gives a message that can be sent on, or a DecodeError, and nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.protocol.legal_messages import JSON, all_kinds, messages

from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import DecodeError

if TYPE_CHECKING:
    from zsight_protocol.message import Message

KINDS = [pytest.param(kind, id=kind.__name__) for kind in all_kinds()]

# First bytes of every msgpack form, with lengths that are short, long and huge.
NASTY = [
    bytes([mark]) + length
    for mark in (*range(0xC0, 0xE0), 0x80, 0x8F, 0x90, 0x9F, 0xA0, 0xBF, 0x00, 0x7F, 0xE0)
    for length in (b"", b"\x00", b"\xff", b"\xff\xff\xff\xff", b"\x00\x00\xff\xff")
]


@st.composite
def mutated(draw: st.DrawFn, payload: bytes) -> bytes:
    """The payload with some runs of bytes replaced by others."""
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(payload)))
        end = min(len(payload), start + draw(st.integers(0, 6)))
        payload = payload[:start] + draw(st.sampled_from(NASTY) | st.binary(max_size=6)) + payload[end:]
    return payload


def message_or_complaint(kind: type[Message], payload: bytes) -> None:
    try:
        message = decode(kind, payload)
    except DecodeError:
        return
    again = decode(kind, encode(message))
    # Compared by their bytes: extras may hold NaN, which is not equal to itself.
    assert encode(again) == encode(message)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60)
@given(data=st.data())
def test_mutated_bytes(kind: type[Message], data: st.DataObject) -> None:
    message_or_complaint(kind, data.draw(mutated(encode(data.draw(messages(kind))))))


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=20)
@given(data=st.data())
def test_entries_exchanged_for_others(kind: type[Message], data: st.DataObject) -> None:
    entries: dict[str, Any] = msgpack.unpackb(encode(data.draw(messages(kind))))
    for name in data.draw(st.lists(st.sampled_from(sorted(entries)), max_size=2)):
        entries[name] = data.draw(JSON | st.binary(max_size=8))
    message_or_complaint(kind, msgpack.packb(entries))


@pytest.mark.parametrize("kind", KINDS)
@given(payload=st.binary(max_size=64) | st.lists(st.sampled_from(NASTY), max_size=20).map(b"".join))
def test_bytes_out_of_nowhere(kind: type[Message], payload: bytes) -> None:
    message_or_complaint(kind, payload)
