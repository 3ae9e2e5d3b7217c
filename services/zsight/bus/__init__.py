"""The bus: typed messages over Zenoh, or over memory in tests."""

from zsight.bus.bus import Bus, Reader, Received, Replies, Writer
from zsight.bus.link import Link, LivelinessWatch, RawReader, RawReplies, RawRequest, RawSample, RawWriter

__all__ = [
    "Bus",
    "Link",
    "LivelinessWatch",
    "RawReader",
    "RawReplies",
    "RawRequest",
    "RawSample",
    "RawWriter",
    "Reader",
    "Received",
    "Replies",
    "Writer",
]
