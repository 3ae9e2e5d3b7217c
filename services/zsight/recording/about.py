"""What is in a recording, as ``bag info`` tells it."""

from __future__ import annotations

import time
from collections import Counter
from typing import TYPE_CHECKING, Any

from zsight.recording.mcap_file import McapFile
from zsight.recording.opening import open_recording
from zsight.recording.recording_file import ABOUT, LOSSES

if TYPE_CHECKING:
    from pathlib import Path

    from zsight.recording.played import Recorded

__all__ = ["about"]


def about(path: Path) -> dict[str, Any]:
    """A recording of any kind in figures.

    Raises:
        UsageError: it cannot be read.
    """
    recording = open_recording(path)
    seconds = (recording.end_ns - recording.start_ns) / 1e9
    topics = _topics(recording, seconds)
    files = [path] if path.is_file() else sorted(file for file in path.iterdir() if file.is_file())
    report = {
        "file": str(path),
        "size": sum(file.stat().st_size for file in files),
        "start_ns": recording.start_ns,
        "begins": time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(recording.start_ns / 1e9)),
        "seconds": seconds,
        "messages": sum(topic["messages"] for topic in topics) + sum(recording.skipped.values()),
        "topics": topics,
        "skipped": recording.skipped,
        "damage": recording.damage,
        "library": "",
        "about": {},
        "losses": {},
        "compression": {},
    }
    recording.close()
    for file in files:
        if file.suffix == ".mcap":
            report |= _of_mcap(file, report)
    return report


def _topics(recording: Recorded, seconds: float) -> list[dict[str, Any]]:
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for line in recording.lines:
        entry = found.setdefault(
            (line.key, line.source),
            {
                "key": line.key.lstrip("/"),
                "type": line.type_name or "bytes",
                "messages": 0,
                "hz": 0.0,
                "source": line.source,
            },
        )
        entry["messages"] += line.count
        entry["hz"] = (entry["messages"] - 1) / seconds if seconds and entry["messages"] > 1 else 0.0
    return sorted((entry for entry in found.values() if entry["messages"]), key=lambda entry: entry["key"])


def _of_mcap(path: Path, report: dict[str, Any]) -> dict[str, Any]:
    with McapFile.open(path) as file:
        losses = Counter(report["losses"])
        for metadata in file.metadata:
            if metadata.name == LOSSES:
                losses.update({key: int(count) for key, count in metadata.entries.items()})
        kinds = Counter(chunk.compression or "none" for chunk in file.chunks if not chunk.loose)
        described = next((m.entries for m in file.metadata if m.name == ABOUT), report["about"])
        return {
            "library": file.library,
            "about": described,
            "losses": dict(losses),
            "compression": dict(Counter(report["compression"]) + kinds),
        }
