"""What was worked out lately, by what it was worked out from."""

from __future__ import annotations

from typing import TypeVar

__all__ = ["MOST", "Recent"]

MOST = 64
"""Entries that are kept; with one more, all before it are forgotten."""

K = TypeVar("K")
V = TypeVar("V")


class Recent(dict[K, V]):
    """A dictionary that does not grow for ever, whatever others send."""

    def keep(self, key: K, value: V) -> V:
        """Remember a value, and return it."""
        if len(self) >= MOST and key not in self:
            self.clear()
        self[key] = value
        return value
