"""The files of one recording: one, or one after the other with numbers, of which the oldest may go."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from zsight.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["FileSeries", "Split"]


@dataclass(frozen=True)
class Split:
    """When another file begins: bytes, seconds (0 for never), and how many files are kept (0 for all)."""

    bytes: int = 0
    seconds: float = 0.0
    keep: int = 0

    @property
    def is_on(self) -> bool:
        """True where there may be more than one file."""
        return bool(self.bytes or self.seconds)


@dataclass
class FileSeries:
    """Names of the files: ``name.mcap``, or ``name_0.mcap``, ``name_1.mcap`` and so on where the recording is split.

    ``files`` are those that were begun and are still there, oldest first.
    """

    path: Path
    split: Split
    files: list[Path] = field(default_factory=list)
    _count: int = 0

    def next(self) -> Path:
        """The path of the next file; the same again until that was begun.

        Raises:
            UsageError: there is no folder to put it in.
        """
        if not self.path.parent.is_dir():
            raise UsageError(f"there is no folder {self.path.parent}: make it first")
        numbered = self.split.is_on or self._count
        return self.path.with_name(f"{self.path.stem}_{self._count}{self.path.suffix}") if numbered else self.path

    def begun(self, path: Path) -> None:
        """The next file is there: it counts, and the oldest go where only some are kept."""
        self._count += 1
        self.files.append(path)
        while self.split.keep and len(self.files) > self.split.keep:
            self.drop_oldest()

    def is_due(self, size: int, begun: float) -> bool:
        """Whether a file of so many bytes, begun at that time (monotonic), is to be followed by another."""
        return bool(
            (self.split.bytes and size >= self.split.bytes)
            or (self.split.seconds and time.monotonic() - begun >= self.split.seconds)
        )

    def drop_oldest(self) -> bool:
        """Remove the oldest file but the last; false where there is none."""
        if len(self.files) < 2:
            return False
        self.files.pop(0).unlink(missing_ok=True)
        return True
