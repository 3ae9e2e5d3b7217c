"""What commands print: JSON for scripts on stdout, words for people on stderr or in tables."""

from __future__ import annotations

import json
import math
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

__all__ = ["print_json", "print_table", "say"]


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
    """A table for people, on stdout."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in headings:
        table.add_column(heading, no_wrap=True)
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    console = Console(soft_wrap=True)
    console.print(table)
