"""How a service ends, and what its exit code says to whoever watches it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from zsight import planes, runtime
from zsight.errors import NotAllowed, UsageError, ZsightError
from zsight.services import service
from zsight_core.errors import GeometryError
from zsight_protocol.errors import EncodeError

if TYPE_CHECKING:
    from zsight.bus import Bus
    from zsight.network import Network
    from zsight.settings import Settings


@pytest.mark.parametrize("error", [UsageError("no"), NotAllowed("no"), GeometryError("no"), EncodeError("no")])
@pytest.mark.parametrize(("ready", "code"), [(False, UsageError.exit_code), (True, ZsightError.exit_code)])
def test_what_happens_once_it_is_ready_is_not_laid_to_its_settings(
    zenoh_network: Network, monkeypatch: pytest.MonkeyPatch, error: Exception, ready: bool, code: int
) -> None:
    monkeypatch.setattr(runtime, "start_logging", lambda _: None)  # this process logs already,
    monkeypatch.setattr(runtime, "_stop_on_signals", lambda _: None)  # and its signals are pytest's

    def loop(bus: Bus, settings: Settings) -> None:
        del settings
        if ready:
            bus.ready()
        raise error

    assert runtime.run_service(service("planes"), planes.Settings(), "planes", zenoh_network, loop=loop) == code
