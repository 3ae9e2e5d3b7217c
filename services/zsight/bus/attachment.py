"""What travels beside every message: who sent it, as which of its messages, and when.

It is made for counting losses and measuring delays on the way; a message is complete without it.
"""

from __future__ import annotations

import os
import struct
from typing import NamedTuple

__all__ = ["Attachment", "new_writer_id"]

_FORM = struct.Struct("<QQQ")


def new_writer_id() -> int:
    """A random 64-bit number: a writer that starts again is another writer."""
    return int.from_bytes(os.urandom(8), "little")


class Attachment(NamedTuple):
    """Writer id, sequence number counted from 1, and nanoseconds since the epoch by the writer's clock."""

    writer: int
    sequence: int
    sent_ns: int

    def pack(self) -> bytes:
        """24 bytes."""
        return _FORM.pack(*self)

    @classmethod
    def unpack(cls, data: bytes) -> Attachment | None:
        """From 24 bytes; none where they are not that."""
        return cls._make(_FORM.unpack(data)) if len(data) == _FORM.size else None
