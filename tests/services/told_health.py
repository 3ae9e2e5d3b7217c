"""The health that the runtime tells of each process, told by a test."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zsight_protocol.codec import encode
from zsight_protocol.health import Health, Level
from zsight_protocol.message import Header, Time

if TYPE_CHECKING:
    from zsight.bus import Bus, RawRequest

__all__ = ["tell_health"]


def tell_health(bus: Bus, process: str) -> None:
    """As the runtime does for each process."""

    def asked(request: RawRequest) -> None:
        now = Time.now()
        writers = tuple(counter.health() for counter in bus.writers)
        health = Health(
            header=Header(stamp=now), host="desk", process=process, service="camera", pid=1, version="0", started=now,
            level=Level.OK, writers=writers,
        )  # fmt: skip
        request.reply(encode(health))
        request.close()

    bus.serve(bus.cell.health("desk", process), asked)
