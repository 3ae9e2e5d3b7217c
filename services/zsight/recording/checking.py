"""Whether a recording is sound: its index, its checksums, its order, and every message in it."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from zsight.recording.mcap_file import McapFile
from zsight.recording.mcap_recording import McapRecording
from zsight.recording.recording_file import IN_FORCE, LOSSES
from zsight_protocol.errors import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from zsight.recording.mcap_file import Entry

__all__ = ["check"]

_MOST = 20  # words of one kind


def check(path: Path) -> dict[str, Any]:
    """What is wrong with an MCAP file: ``errors`` that make it unsound, ``gaps`` of messages that are not in it.

    Raises:
        UsageError: it is no MCAP file.
    """
    errors: list[str] = []
    with McapFile.open(path) as indexed:
        if indexed.damage:
            errors.append(indexed.damage)
        promised = indexed.statistics
    with McapFile.open(path, walk=True) as file:
        if file.damage and file.damage not in errors:
            errors.append(file.damage)
        found = file.statistics
        if (found.messages, found.by_channel) != (promised.messages, _without_none(promised.by_channel)):
            errors.append(f"the index promises {promised.messages} messages; the chunks hold {found.messages}")
        errors += _wrong_chunks(file)
        gaps = _gaps(file.messages())
        told = {m.name: m.entries for m in file.metadata}.get(LOSSES, {})
    refused = _refused(path) if found.messages else []
    errors += [words for words in refused if words not in errors]
    return {
        "file": str(path),
        "messages": found.messages,
        "chunks": found.chunks,
        "errors": errors,
        "gaps": gaps,
        "losses": {key: int(count) for key, count in told.items()},
        "sound": not errors,
    }


def _without_none(counts: dict[int, int]) -> dict[int, int]:
    return {channel: count for channel, count in counts.items() if count}


def _wrong_chunks(file: McapFile) -> list[str]:
    wrong: list[str] = []
    for chunk in file.chunks:
        times = [entry.log_time for entry in file.entries(chunk)]
        if not chunk.loose and (min(times) < chunk.start or max(times) > chunk.end):
            wrong.append(f"the chunk at byte {chunk.offset} holds messages outside of its time")
    return wrong[:_MOST]


def _gaps(entries: Iterable[Entry]) -> dict[str, int]:
    """Messages by topic that their writer sent and that are missing between those that are there."""
    last: dict[int, int] = {}
    missing: Counter[str] = Counter()
    for entry in entries:
        channel, sequence = entry.channel, entry.sequence
        if channel.metadata.get("writer") and IN_FORCE not in channel.metadata:
            before = last.get(channel.id, sequence - 1)
            missing[channel.topic] += max(sequence - before - 1, 0)
            last[channel.id] = max(sequence, before)
    return {topic: count for topic, count in sorted(missing.items()) if count}


def _refused(path: Path) -> list[str]:
    """Chunks and messages that cannot be read, by the index."""
    chunks: list[str] = []
    recording = McapRecording(path, lambda _, words: chunks.append(words))
    refused: Counter[str] = Counter()
    for played in recording.messages(recording.start_ns, None, recording.lines):
        try:
            played.load()
        except ProtocolError as error:
            refused[f"{played.line.source}: {error}"] += 1
    recording.close()
    return chunks[:_MOST] + [f"{count} times {words}" for words, count in refused.most_common(_MOST)]
