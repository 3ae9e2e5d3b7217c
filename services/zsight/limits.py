"""What is taken from the network and from recordings at most: every limit on what others send, in one place.

What the messages themselves may hold stands with them, in zsight_protocol; how many goals a finder takes, in its
settings ``parallel`` and ``queue``.
"""

from __future__ import annotations

__all__ = [
    "CHUNK_BYTES",
    "FRAMES",
    "MESSAGE_BYTES",
    "REQUESTS_PER_SECOND",
    "REQUEST_BYTES",
    "SESSIONS",
    "TRANSFORMS",
    "WAITING",
]

MESSAGE_BYTES = 512 * 2**20
"""Largest message: 33 million points of 16 bytes. Zenoh drops the link of who sends more, a reader refuses it."""

CHUNK_BYTES = 2 * MESSAGE_BYTES
"""Largest chunk of a recording, unpacked: one largest message and what came before it; most writers stay below 5 MB."""

WAITING = 256
"""Messages that wait for a reader of a channel on which each counts; more are lost, and counted. Also requests that
wait to be answered one after the other; more are refused."""

REQUEST_BYTES = 2**20
"""Largest request; goals, types and settings are some kilobytes."""

REQUESTS_PER_SECOND = 5000.0
"""Requests on one key that are looked at; more are refused at once. A fast client on this host asks 2000 a second."""

FRAMES = 4096
"""Frames whose place a process keeps; a robot has some hundred. Others are left out, and the log says so."""

TRANSFORMS = 2**14
"""Times at which it remembers the place of a frame, of the last ten seconds: a thousand a second are many."""

SESSIONS = 256
"""Processes that join one router."""
