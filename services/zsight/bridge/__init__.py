"""Bridges that show a cell in other viewers: clouds, frames and found objects go there, nothing comes back."""

from __future__ import annotations

from zsight.bridge.feed import Sink, feed

__all__ = ["Sink", "feed"]
