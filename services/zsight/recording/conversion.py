"""Recordings of any kind as MCAP files of our own."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from zsight.bus.attachment import Attachment
from zsight.recording.compression import stored_name
from zsight.recording.opening import open_recording
from zsight.recording.recording_file import RecordingFile
from zsight.recording.sample import Sample
from zsight_protocol.codec import encode
from zsight_protocol.errors import ProtocolError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.recording.played import Played

__all__ = ["as_sample", "convert"]


def as_sample(played: Played, namespace: str, sequence: int) -> Sample:
    """A recorded message as if it had just come off the wire, as such a message of its writer.

    Raises:
        ProtocolError: it cannot be read.
    """
    message = played.load()
    payload = message if isinstance(message, bytes) else encode(message)
    attachment = Attachment(played.line.number + 1, sequence, played.publish_time)
    return Sample(played.line.full_key(namespace), payload, attachment, played.log_time)


def convert(
    source: Path,
    target: Path,
    *,
    namespace: str = "zsight",
    compression: str | None = None,
    say: Callable[[float], object] = lambda _: None,
) -> tuple[int, dict[str, int]]:
    """Write a recording of any kind as one of a cell: topics become keys, depth images clouds.

    Args:
        source: what can be played.
        target: the new file.
        namespace: of the keys.
        compression: none, lz4 or zstd; that of the source if not given.
        say: told the share of it that is done, 0 to 1.

    Returns:
        Messages in the new file; by topic, those that are not.

    Raises:
        UsageError: the source cannot be read or is damaged, or the target is there already.
    """
    recording = open_recording(source)
    stored = stored_name(compression, recording.compression)
    left, sent = Counter(recording.skipped), Counter[int]()
    count, span = 0, max(recording.end_ns - recording.start_ns, 1)
    file = RecordingFile(target, namespace, {"converted from": source.name})
    try:
        for played in recording.messages(recording.start_ns, None, recording.lines):
            say((played.log_time - recording.start_ns) / span)
            sent[played.line.number] += 1
            try:
                sample = as_sample(played, namespace, sent[played.line.number])
            except ProtocolError:
                left[played.line.source] += 1
                continue
            if file.write(sample):
                file.mcap.close_chunk(stored)
            count += 1
        file.finish(stored, whole=True)
    except BaseException:
        target.unlink(missing_ok=True)
        raise
    finally:
        recording.close()
    return count, dict(left)
