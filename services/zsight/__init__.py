"""Object finding in point clouds over Eclipse Zenoh: the processes, the bus, the client, the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from zsight.client import CellClient, connect

__all__ = ["CellClient", "connect"]


def __getattr__(name: str) -> Any:
    """The client, imported when first asked for: services and commands that need none start faster."""
    if name in __all__:
        from zsight import client

        return getattr(client, name)
    raise AttributeError(f"module zsight has no attribute {name!r}")
