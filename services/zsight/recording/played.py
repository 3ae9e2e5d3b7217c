"""A recording as the player sees it, whoever made it: messages with their time and their key in a cell."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from zsight_protocol.channels import Delivery
    from zsight_protocol.message import Message

__all__ = ["Line", "Played", "Recorded"]


@dataclass(frozen=True)
class Line:
    """What one writer sent on one key: ``key`` is without the namespace; ``source`` its name in the file.

    A key that was in no namespace begins with a slash.
    ``kind`` is none where the bytes are handed on as they are. ``in_force`` marks what was sent before the file began.
    """

    number: int
    key: str
    source: str
    kind: type[Message] | None
    delivery: Delivery
    count: int = 0
    type_name: str = ""
    in_force: bool = False

    def full_key(self, namespace: str) -> str:
        """Its key in a namespace."""
        return self.key[1:] if self.key.startswith("/") else f"{namespace}/{self.key}"


@dataclass(frozen=True)
class Played:
    """One message; ``load`` reads it, or its bytes where its kind is not known, and may raise ProtocolError."""

    line: Line
    log_time: int
    publish_time: int
    sequence: int
    load: Callable[[], Message | bytes] = field(repr=False)


class Recorded(Protocol):
    """An open recording; times are nanoseconds since the epoch."""

    start_ns: int
    end_ns: int
    lines: list[Line]
    skipped: dict[str, int]
    damage: str
    compression: str  # as MCAP calls it; empty where there is none, or it is not known

    def messages(self, start: int, end: int | None, lines: Collection[Line]) -> Iterator[Played]:
        """Messages of some lines from start up to and without end, in their order."""

    def last_before(self, time: int, lines: Collection[Line]) -> Played | None:
        """The last message of some lines before a time."""

    def close(self) -> None:
        """Close the files."""
