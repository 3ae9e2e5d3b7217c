"""One file of a recording: messages of zsight as MCAP with the profile ros2, and what is counted about them."""

from __future__ import annotations

import json
import logging
import platform
import time
from collections import Counter
from importlib import metadata
from typing import TYPE_CHECKING

from zsight.recording.mcap_records import Metadata
from zsight.recording.mcap_writer import McapWriter
from zsight.recording.topic_name import topic_of
from zsight_protocol.channels import Delivery, channel_of
from zsight_protocol.codec import decode
from zsight_protocol.errors import KeyNameError, ProtocolError
from zsight_protocol.ros_message import ros_type, to_cdr

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from zsight.recording.mcap_records import Statistics
    from zsight.recording.sample import Sample
    from zsight_protocol.channels import Channel
    from zsight_protocol.message import Message
    from zsight_protocol.point_cloud import Buffer

log = logging.getLogger(__name__)

__all__ = ["ABOUT", "IN_FORCE", "LOSSES", "RecordingFile", "row_of"]

ABOUT = "zsight"
"""Name of the metadata at the beginning: what was recorded, by which versions."""
LOSSES = "zsight.losses"
"""Name of the metadata at the end: how many messages of each key came and could not be written."""
IN_FORCE = "in_force"
"""Mark in the metadata of a channel whose messages were in force when the file began, and came before."""


def row_of(key: str, namespace: str) -> Channel | None:
    """The row of the channel table that a key belongs to, if any."""
    try:
        return channel_of(key, namespace)
    except KeyNameError:
        return None


class RecordingFile:
    """Writes samples; not safe between threads."""

    def __init__(
        self,
        path: Path,
        namespace: str,
        about: dict[str, str],
        coded: Callable[[str, Message], Message] = lambda _, message: message,
    ) -> None:
        """Create the file.

        Args:
            path: where it shall be.
            namespace: of the keys.
            about: further entries of its first metadata.
            coded: called with the key and every message; what it returns is written in its place.

        Raises:
            UsageError: there is a file already.
            OSError: the system refuses.
        """
        version = metadata.version("zsight")
        self.mcap = McapWriter(path, f"zsight {version}")
        self.path = path
        self.begun = time.monotonic()
        self._namespace = namespace
        self._coded = coded
        self._channels: dict[tuple[str, int, bool, str], int] = {}
        self._key_of_channel: dict[int, str] = {}
        self._rows: dict[str, Channel | None] = {}
        self._came: Counter[str] = Counter()
        self._lost: Counter[str] = Counter()
        self._missing: dict[str, int] | None = None  # what is lost in the end
        versions = {"version": version, "python": platform.python_version(), "platform": platform.platform()}
        try:
            self.mcap.add_metadata(Metadata(ABOUT, {"namespace": namespace, **versions, **about}))
        except OSError:
            self.mcap.discard()
            raise

    def begin_with(self, samples: Iterable[Sample], begin_ns: int) -> None:
        """Write what was in force before the first message, with the time at which the file begins."""
        for sample in samples:
            self._write(sample, begin_ns, in_force=True)

    def write(self, sample: Sample) -> bool:
        """Write a message into the open chunk; true where that is full and should be closed."""
        return self._write(sample, sample.received_ns, in_force=False)

    def lose(self, key: str, count: int = 1) -> None:
        """Count messages that never got here."""
        self._lost[key] += count

    def _write(self, sample: Sample, log_time: int, *, in_force: bool) -> bool:
        row = self._row(sample.key)
        kind, parts = self._encoded(sample, row)
        channel = self._channel(sample, row, kind, in_force=in_force)
        if not in_force:  # what came before is in the file before, or was not asked for
            self._came[sample.key] += 1
        sent, sequence = log_time, 0
        if sample.attachment is not None:
            sent, sequence = sample.attachment.sent_ns, sample.attachment.sequence
        return self.mcap.add(channel, log_time, sent, sequence, parts)

    def _row(self, key: str) -> Channel | None:
        if key not in self._rows:
            self._rows[key] = row_of(key, self._namespace)
        return self._rows[key]

    def _encoded(self, sample: Sample, row: Channel | None) -> tuple[type[Message] | None, list[Buffer]]:
        """The kind and the bytes of a message; bytes that are not what their key carries are kept as they came."""
        if row is None or row.message is None:
            return None, [sample.payload]
        try:
            message = self._coded(sample.key, decode(row.message, sample.payload))
            return type(message), to_cdr(message)
        except (ProtocolError, TypeError, ValueError) as error:
            log.debug("a message on %s is kept as it came: %s", sample.key, error)
            return None, [sample.payload]

    def _channel(self, sample: Sample, row: Channel | None, kind: type[Message] | None, *, in_force: bool) -> int:
        key = (sample.key, sample.writer, in_force, "" if kind is None else kind.__name__)
        if key not in self._channels:
            entries = {"key": sample.key, "delivery": "" if row is None else row.delivery.value}
            if sample.writer:
                entries["writer"] = str(sample.writer)
            if in_force:
                entries[IN_FORCE] = "1"
            if row is not None and row.delivery is Delivery.LATCHED:
                entries["offered_qos_profiles"] = _LATCHED_QOS
            schema = 0
            if kind is not None:
                ros = ros_type(kind)
                schema = self.mcap.schema(ros.name, "ros2msg", ros.text.encode())
            encoding = "msgpack" if kind is None else "cdr"
            number = self.mcap.channel(topic_of(sample.key), schema, encoding, entries)
            self._channels[key] = number
            if not in_force:
                self._key_of_channel[number] = sample.key
        return self._channels[key]

    def losses(self) -> dict[str, int]:
        """Messages by key that came and are not in the file; before it is closed, as far as is known."""
        if self._missing is not None:
            return self._missing
        return {key: count for key, count in sorted(self._lost.items()) if count}

    def finish(self, compression: str = "", *, whole: bool = False) -> dict[str, int]:
        """Close the file; the messages by key that came and are not in it; a whole one raises OSError in their place.

        Raises:
            OSError: the system refuses to write even the index; the file can be recovered.
        """

        def closing(statistics: Statistics) -> Metadata:
            written: Counter[str] = Counter()
            for channel, key in self._key_of_channel.items():
                written[key] += statistics.by_channel.get(channel, 0)
            missing = {key: count - written[key] + self._lost[key] for key, count in self._came.items()}
            missing |= {key: count for key, count in self._lost.items() if key not in self._came}
            self._missing = {key: count for key, count in sorted(missing.items()) if count}
            return Metadata(LOSSES, {key: str(count) for key, count in self._missing.items()})

        self.mcap.finish(compression, closing, whole=whole)
        return self.losses()


_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_LATCHED_QOS = json.dumps(  # as rosbag2 writes it: keep last, reliable, transient local
    [
        {
            "history": 1, "depth": 1, "reliability": 1, "durability": 1, "deadline": _FOREVER, "lifespan": _FOREVER,
            "liveliness": 1, "liveliness_lease_duration": _FOREVER, "avoid_ros_namespace_conventions": False,
        }
    ]
)  # fmt: skip
