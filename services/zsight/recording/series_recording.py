"""Files that follow each other, as a split recording makes them, as one."""

from __future__ import annotations

import heapq
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from zsight.recording.played import Line, Played, Recorded

__all__ = ["SeriesRecording"]


class SeriesRecording:
    """Several recordings as one; what a later file repeats of what was in force is not repeated."""

    def __init__(self, parts: list[Recorded]) -> None:
        """Args: recordings, at least one."""
        self._parts = parts
        self.start_ns, self.end_ns = min(p.start_ns for p in parts), max(p.end_ns for p in parts)
        self.damage = "; ".join(part.damage for part in parts if part.damage)
        self.compression = next((part.compression for part in parts if part.compression), "")
        self.skipped = {name: count for part in parts for name, count in part.skipped.items()}
        self._own: list[tuple[Recorded, Line]] = []
        self.lines: list[Line] = []
        for part in sorted(parts, key=lambda p: p.start_ns):
            for line in part.lines:
                if line.in_force and part.start_ns != self.start_ns:
                    continue
                self.lines.append(replace(line, number=len(self._own)))
                self._own.append((part, line))

    def _inside(self, part: Recorded, lines: Collection[Line]) -> dict[int, Line]:
        """By their number in a part, the lines that are wanted of it."""
        return {self._own[line.number][1].number: line for line in lines if self._own[line.number][0] is part}

    def messages(self, start: int, end: int | None, lines: Collection[Line]) -> Iterator[Played]:
        """Messages of some lines from start up to and without end, in their order."""
        streams = [self._of_part(part, start, end, self._inside(part, lines)) for part in self._parts]
        return heapq.merge(*streams, key=lambda played: played.log_time)

    def _of_part(self, part: Recorded, start: int, end: int | None, lines: dict[int, Line]) -> Iterator[Played]:
        wanted = [line for line in part.lines if line.number in lines]
        for played in part.messages(start, end, wanted) if wanted else ():
            yield replace(played, line=lines[played.line.number])

    def last_before(self, time: int, lines: Collection[Line]) -> Played | None:
        """The last message of some lines before a time."""
        found: list[Played] = []
        for part in self._parts:
            inside = self._inside(part, lines)
            wanted = [line for line in part.lines if line.number in inside]
            played = part.last_before(time, wanted) if wanted else None
            if played is not None:
                found.append(replace(played, line=inside[played.line.number]))
        return max(found, key=lambda played: played.log_time, default=None)

    def close(self) -> None:
        """Close the files."""
        for part in self._parts:
            part.close()
