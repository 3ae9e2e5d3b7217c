"""What a reader knows of one writer: the last of its messages, how often they come and how fast the way is."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zsight.bus.attachment import Attachment

__all__ = ["WriterTrack"]

_MEMORY_NS = 10_000_000_000  # the fastest message of the last 10 to 20 s says how fast the way is
_RESTART = 2**32  # a gap this wide is no loss: somebody made the number up


class WriterTrack:
    """Follows the numbers and times in one writer's attachments; differences of times need no common clock."""

    def __init__(self, first: Attachment, now_ns: int) -> None:
        """Args: first message that came, and when; what was sent before it is no loss."""
        self._sequence = first.sequence - 1
        self._sent_ns = first.sent_ns
        self.period_ns = 0
        self._fastest = self._fastest_before = now_ns - first.sent_ns
        self._window_ends = now_ns + _MEMORY_NS

    def arrived(self, attachment: Attachment, now_ns: int) -> int:
        """Follow one message; how many are missing before it."""
        missing = attachment.sequence - self._sequence - 1
        if missing < 0:
            return 0
        steps = missing + 1
        self.period_ns = max(attachment.sent_ns - self._sent_ns, 0) // steps
        self._sequence, self._sent_ns = attachment.sequence, attachment.sent_ns
        self._follow_way(now_ns - attachment.sent_ns, now_ns)
        return missing if missing < _RESTART else 0

    def _follow_way(self, transit_ns: int, now_ns: int) -> None:
        if now_ns >= self._window_ends:
            self._fastest_before, self._fastest = self._fastest, transit_ns
            self._window_ends = now_ns + _MEMORY_NS
        self._fastest = min(self._fastest, transit_ns)

    def delay_ns(self, attachment: Attachment, now_ns: int) -> int:
        """How much longer than its writer's fastest message one took until now."""
        return now_ns - attachment.sent_ns - min(self._fastest, self._fastest_before)
