"""What commands print: JSON for scripts on stdout, words for people on stderr or in tables."""

from __future__ import annotations

import json
import math
import shutil
import sys
import textwrap
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["print_json", "print_table", "say"]

_NARROWEST = 20  # columns; a last column with less room is not folded


def print_json(value: Any) -> None:
    """One JSON object on one line; numbers that JSON has no word for become null."""
    sys.stdout.write(json.dumps(_legal(value), separators=(", ", ": ")) + "\n")
    sys.stdout.flush()


def _legal(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _legal(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_legal(entry) for entry in value]
    if hasattr(value, "tolist"):
        return _legal(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def say(words: str) -> None:
    """A line for people, on stderr."""
    sys.stderr.write(words + "\n")
    sys.stderr.flush()


def print_table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A table for people, on stdout; without headings a list of names and values.

    Nothing is cut off: at a terminal the last column goes on in further lines, elsewhere the lines are as long as they
    have to be.
    """
    body = [[str(cell) for cell in row] for row in rows]
    lines = [list(headings), *body] if headings else body
    widths = [max(map(len, column)) for column in zip(*(line[:-1] for line in lines), strict=True)]
    room = shutil.get_terminal_size().columns - sum(widths) - 2 * len(widths) if sys.stdout.isatty() else 0
    for place, line in enumerate(lines):
        start = "".join(cell.ljust(width + 2) for cell, width in zip(line, widths, strict=False))
        ends = textwrap.wrap(line[-1], room) if room >= _NARROWEST else [line[-1]]
        text = start + ("\n" + " " * len(start)).join(ends)
        bold = headings and not place and sys.stdout.isatty()
        sys.stdout.write(f"\x1b[1m{text.rstrip()}\x1b[0m\n" if bold else text.rstrip() + "\n")
    sys.stdout.flush()
