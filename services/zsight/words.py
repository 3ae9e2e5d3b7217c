"""Numbers in words, wherever people read them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["number", "numbers"]


def number(value: float, digits: int = 4) -> str:
    """A number with so many decimals, and zero without a sign."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0 else text


def numbers(values: Iterable[float], digits: int = 4) -> str:
    """Numbers in parentheses, as coordinates are written."""
    return "(" + ", ".join(number(value, digits) for value in values) + ")"
