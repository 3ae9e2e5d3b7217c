"""The process table: every service, its module, and what it does. A new service is a module and a line here."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from zsight.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Bus
    from zsight.settings import Settings

__all__ = ["SERVICES", "Service", "service"]


@dataclass(frozen=True)
class Service:
    """One row: a module with ``Settings`` and ``run(bus, settings)``."""

    name: str
    module: str
    does: str

    def settings(self) -> type[Settings]:
        """The module's settings."""
        kind: type[Settings] = import_module(self.module).Settings
        return kind

    def run(self) -> Callable[[Bus, Settings], None]:
        """The module's loop."""
        loop: Callable[[Bus, Settings], None] = import_module(self.module).run
        return loop


SERVICES = (
    Service("router", "zsight.router", "the Zenoh router that all others join"),
    Service(
        "camera", "zsight.camera", "one source of clouds: simulated scene, ellipse, files, RGB-D images, recordings"
    ),
    Service("voxel", "zsight.voxel", "voxel-grid downsampler"),
    Service("planes", "zsight.planes", "plane of a selected patch, and its coplanar points"),
    Service("finder", "zsight.finder", "object finder"),
    Service("viewer", "zsight.viewer", "the browser page"),
    Service("recorder", "zsight.recording.recorder", "writes what travels in the cell to MCAP files"),
    Service("player", "zsight.recording.player", "sends a recording as if it were live"),
)


def service(name: str) -> Service:
    """The row with this name.

    Raises:
        UsageError: there is none.
    """
    for row in SERVICES:
        if row.name == name:
            return row
    names = [row.name for row in SERVICES]
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(names)}"
    raise UsageError(f"no service is called {name!r}: {hint}")
