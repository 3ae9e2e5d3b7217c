"""The router service: a Zenoh router in a Python process, which all other processes join."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zsight.settings import Settings as ServiceSettings

if TYPE_CHECKING:
    from zsight.bus import Bus

__all__ = ["Settings", "run"]


class Settings(ServiceSettings):
    """The router has none: where it listens is a matter of the network, see ``--listen``."""


def run(bus: Bus, settings: Settings) -> None:
    """Be there until told to stop; Zenoh does the rest."""
    del settings
    bus.ready()
    bus.stopping.wait()
