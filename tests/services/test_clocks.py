"""Clocks of other hosts, told by the stamps of their answers."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest

from zsight.bus import Bus
from zsight.bus.memory_link import MemoryLink, MemoryNetwork
from zsight.hosts.clocks import Clock, ask_clocks
from zsight_protocol.codec import encode
from zsight_protocol.health import Health, Level
from zsight_protocol.message import Header, Time

if TYPE_CHECKING:
    from zsight.bus import RawRequest


def serve(bus: Bus, host: str, process: str, ahead: float) -> None:
    """A process whose clock runs ahead."""

    def asked(request: RawRequest) -> None:
        stamp = Time.from_ns(time.time_ns() + int(ahead * 1e9))
        health = Health(
            header=Header(stamp=stamp),
            host=host,
            process=process,
            service="camera",
            pid=1,
            version="0",
            started=stamp,
            level=Level.OK,
        )
        request.reply(encode(health))
        request.close()

    bus.serve(bus.cell.health(host, process), asked)


@pytest.mark.parametrize("ahead", [0.0, 0.5, -0.3])
def test_a_clock_is_measured_to_its_uncertainty(ahead: float) -> None:
    network = MemoryNetwork()
    with Bus(MemoryLink(network)) as there, Bus(MemoryLink(network)) as here:
        serve(there, "far", "camera", ahead)
        serve(there, "far", "voxel", ahead)
        serve(there, "near", "camera", 0.0)
        far, near = ask_clocks(here)
    assert (far.host, near.host) == ("far", "near")
    assert abs(far.offset - ahead) <= far.uncertainty + 1e-3
    assert bool(far.warning) == (abs(ahead) > 0.02)
    assert not near.warning


def test_nobody_has_no_clock() -> None:
    with Bus(MemoryLink()) as bus:
        assert ask_clocks(bus, 0.1) == []


@pytest.mark.parametrize(
    ("offset", "uncertainty", "warns"),
    [(0.019, 0.0, False), (0.021, 0.0, True), (-0.021, 0.0, True), (0.05, 0.04, False), (-0.2, 0.04, True)],
)
def test_a_warning_needs_more_than_20_ms_for_sure(offset: float, uncertainty: float, warns: bool) -> None:
    warning = Clock("pi", offset, uncertainty).warning
    assert bool(warning) is warns
    if warns:
        assert ("ahead of" if offset > 0 else "behind") in warning
