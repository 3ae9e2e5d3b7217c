"""What a recorder and a player are asked, and what they tell of themselves."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field, Strict, StringConstraints

from zsight_protocol.message import Bare, Count, Float64, Header, Message, Time

__all__ = [
    "Clock",
    "DepthCodedCloud",
    "KeyLoss",
    "PlayerRequest",
    "PlayerState",
    "Playing",
    "RecorderRequest",
    "RecorderState",
    "Recording",
]

Path = Annotated[str, Field(max_length=4096)]


class Recording(StrEnum):
    """What a recorder is doing."""

    IDLE = "idle"
    ARMED = "armed"  # the last seconds are kept in memory until something triggers
    RECORDING = "recording"
    DISK_FULL = "disk_full"  # waits until there is room again


class RecorderRequest(Message):
    """Start a recording (at a path, or at one of the recorder's own choice), stop it, trigger what is kept in memory.

    ``keys`` are key expressions in place of the recorder's own; ``status`` changes nothing.
    """

    action: Annotated[str, StringConstraints(pattern=r"^(start|stop|trigger|status)$")]
    path: Path = ""
    keys: Annotated[tuple[str, ...], Strict(False), Field(max_length=256)] = ()


class KeyLoss(Message):
    """Messages of one key that came and could not be written."""

    key: str
    lost: Count


class RecorderState(Message):
    """How a recorder stands; the answer to every request, and latched after every change and each second.

    ``safe_ns`` (epoch): whatever arrived before is on the disk. ``in_memory`` seconds are kept for a trigger. Rates
    are those of the last seconds; ``bytes_written`` counts the file, with ``bytes_in`` the messages themselves.
    """

    header: Header
    recorder: str
    state: Annotated[Recording, Bare()]
    ok: bool = True
    message: str = ""
    path: Path = ""
    seconds: Float64 = 0.0
    messages: Count = 0
    bytes_in: Count = 0
    bytes_written: Count = 0
    bytes_per_second: Float64 = 0.0
    lost: Count = 0
    losses: Annotated[tuple[KeyLoss, ...], Strict(False)] = ()
    safe_ns: Count = 0
    disk_free: Count = 0
    compression: str = ""
    in_memory: Float64 = 0.0
    files: Count = 0


class Playing(StrEnum):
    """What a player is doing."""

    EMPTY = "empty"  # no recording is open
    PLAYING = "playing"
    PAUSED = "paused"
    ENDED = "ended"


class PlayerRequest(Message):
    """Control a player: ``position`` (seconds from the beginning) for seek, ``rate`` for rate, ``path`` for open.

    ``step`` sends the next message and stays paused; ``status`` changes nothing.
    """

    action: Annotated[str, StringConstraints(pattern=r"^(play|pause|toggle|step|seek|rate|loop|open|status)$")]
    position: Annotated[Float64, Field(ge=0)] | None = None
    rate: Annotated[Float64, Field(gt=0, le=1000)] | None = None
    loop: bool | None = None
    path: Path = ""


class PlayerState(Message):
    """How a player stands; the answer to every request, and sent after every change and several times a second.

    ``position`` and ``duration`` are seconds from the beginning of the recording, whose first message was recorded at
    ``start_ns`` (epoch). ``late_p99_ms`` tells how late messages of late were sent, measured against their time.
    ``damaged`` counts the chunks of the recording that were left out because they are damaged.
    """

    header: Header
    player: str
    state: Annotated[Playing, Bare()]
    ok: bool = True
    message: str = ""
    path: Path = ""
    position: Float64 = 0.0
    duration: Float64 = 0.0
    start_ns: Count = 0
    rate: Float64 = 1.0
    loop: bool = False
    sent: Count = 0
    skipped: Count = 0
    damaged: Count = 0
    late_p99_ms: Float64 = 0.0


class DepthCodedCloud(Message):
    """A cloud of a depth camera as its images, in a recording only: it comes back within one unit on every axis.

    ``depth`` is height x width numbers of 16 bits, little-endian, ``depth_scale`` metres a unit, 0 where nothing was
    measured; ``colour`` red, green, blue of each pixel, empty without; fx, fy, cx, cy in pixels, no distortion.
    """

    header: Header
    height: Annotated[int, Field(ge=1, lt=2**16)]
    width: Annotated[int, Field(ge=1, lt=2**16)]
    fx: Annotated[Float64, Field(gt=0)]
    fy: Annotated[Float64, Field(gt=0)]
    cx: Float64
    cy: Float64
    depth_scale: Annotated[Float64, Field(gt=0, le=1)]
    has_colour: bool
    depth: bytes
    colour: bytes = b""


class Clock(Message):
    """The time that a player has reached (rosgraph_msgs/Clock)."""

    clock: Time
