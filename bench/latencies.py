"""What the last process of a measured chain prints: for every cloud its stamp and how long it took, one line each."""

from __future__ import annotations

import sys
import time


class Latencies:
    """Prints ``STAMP_NS LATENCY_NS`` a line, for whoever started the process."""

    def add(self, stamp_ns: int) -> None:
        """A cloud with this stamp can be used now."""
        now = time.time_ns()
        sys.stdout.write(f"{stamp_ns} {now - stamp_ns}\n")
        sys.stdout.flush()
