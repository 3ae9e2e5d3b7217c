"""The replies to one request, as long as there is a network that they can come through."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from zsight.errors import ConnectionLost

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight.bus.link import Link, RawReplies

__all__ = ["Replies"]

_LOOK = 0.05  # seconds between two looks at the network


class Replies:
    """Zenoh ends a request when its server goes, but not when the asker itself is cut off: this looks after that."""

    def __init__(self, link: Link, raw: RawReplies) -> None:
        """Args: link that was asked on; its replies."""
        self._link = link
        self._raw = raw

    def take(self, timeout: float) -> bytes | None:
        """The next reply, or none at the end of the stream.

        Raises:
            TimeoutError: none came within timeout seconds.
            RequestRefused: the server refused the request.
            ConnectionLost: this process was cut off from the network.
        """
        deadline = time.monotonic() + timeout
        while True:
            left = deadline - time.monotonic()
            try:
                return self._raw.take(min(left, _LOOK))
            except TimeoutError:
                if left <= _LOOK:
                    raise
            if not self._link.connected():
                self.close()
                raise ConnectionLost("cut off from the network while waiting for an answer: ask again")

    def within(self, timeout: float) -> Iterator[bytes]:
        """Replies until the stream ends or timeout seconds have passed, whichever comes first."""
        deadline = time.monotonic() + timeout
        try:
            while (payload := self.take(deadline - time.monotonic())) is not None:
                yield payload
        except TimeoutError:
            self.close()

    def close(self) -> None:
        """Read no more; whoever answers is not told."""
        self._raw.close()
