"""Tells on stderr how far a measurement is, for whoever waits for it."""

from __future__ import annotations

import sys
import time

_BEGAN = time.monotonic()


def tell(words: str) -> None:
    """A line with the seconds since the beginning."""
    print(f"{time.monotonic() - _BEGAN:4.0f} s  {words}", file=sys.stderr, flush=True)
