"""A message as it came off the wire, waiting to be written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zsight.bus.attachment import Attachment

__all__ = ["Sample"]


@dataclass(frozen=True)
class Sample:
    """Bytes of one message, its key, what its writer attached, and when it was here (ns, this host, no two alike)."""

    key: str
    payload: bytes
    attachment: Attachment | None
    received_ns: int

    @property
    def writer(self) -> int:
        """Who sent it; 0 where that is not known."""
        return self.attachment.writer if self.attachment is not None else 0
