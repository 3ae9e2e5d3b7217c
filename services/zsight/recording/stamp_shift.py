"""Messages with other times in their headers."""

from __future__ import annotations

from typing import TypeVar

from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Header, Message, Time

__all__ = ["shifted"]

M = TypeVar("M", bound=Message)


def shifted(message: M, by_ns: int) -> M:
    """The message with the stamps of its headers so much later; one that has no header as it is."""
    if by_ns == 0:
        return message
    if isinstance(message, TransformList):
        moved = tuple(shifted(transform, by_ns) for transform in message.transforms)
        return message.model_copy(update={"transforms": moved})
    header = getattr(message, "header", None)
    if not isinstance(header, Header):
        return message
    stamp = Time.from_ns(max(header.stamp.ns + by_ns, 0))
    return message.model_copy(update={"header": header.model_copy(update={"stamp": stamp})})
