"""Lengths that lie allocate nothing: memory is bounded by the bytes that really came."""

from __future__ import annotations

import tracemalloc
from typing import TYPE_CHECKING

import pytest

from zsight_protocol.codec import decode
from zsight_protocol.errors import DecodeError
from zsight_protocol.find_object import FindObjectResult
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from zsight_protocol.message import Message

# Two unpackers copy the bytes, each into a buffer that may grow to twice their size.
COPIES = 6
# Smallest part of a payload, one byte, as the largest object that it can make: an empty map and its place in a list.
OBJECTS = 80
FIXED = 100_000

START = b"\x81\xa6report"
BOMBS = {
    "array of 2^32": START + b"\xdd\xff\xff\xff\xff",
    "map of 2^32": START + b"\xdf\xff\xff\xff\xff",
    "text of 2^32": START + b"\xdb\xff\xff\xff\xff",
    "binary of 2^32": START + b"\xc6\xff\xff\xff\xff",
    "extension of 2^32": START + b"\xc9\xff\xff\xff\xff\x01",
    "the map itself": b"\xdf\xff\xff\xff\xff",
    "data of 2^32": b"\x81\xa4data\xc6\xff\xff\xff\xff",
    "arrays in arrays": START + b"\xdd\x00\x00\x10\x00" * 1000,
    "arrays in arrays, bytes behind": START + b"\xdd\x00\x00\xff\x00" * 1000 + bytes(65_000),
    "maps in maps": START + b"\xdf\x00\x00\x10\x00\xa1a" * 700,
    "array longer than what is left": START + b"\xdd\x00\x10\x00\x00" + bytes(500_000),
}


def peak_of(kind: type[Message], payload: bytes) -> int:
    """Bytes that were allocated at once while the payload was refused."""
    with pytest.raises(DecodeError):  # the first time pays for what is made once
        decode(kind, payload)
    tracemalloc.start()
    with pytest.raises(DecodeError):
        decode(kind, payload)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.parametrize("kind", [FindObjectResult, PointCloud2])
@pytest.mark.parametrize("payload", BOMBS.values(), ids=BOMBS.keys())
def test_a_length_that_lies_allocates_no_more_than_copies_of_the_payload(kind: type[Message], payload: bytes) -> None:
    assert peak_of(kind, payload) <= COPIES * len(payload) + FIXED


def test_what_is_really_there_costs_its_objects_and_no_more() -> None:
    payload = START + b"\xdd\x00\x01\x86\xa0" + b"\x80" * 100_000  # 100 000 empty maps
    assert peak_of(FindObjectResult, payload) <= (COPIES + OBJECTS) * len(payload) + FIXED
