"""Object finding in point clouds over Eclipse Zenoh: the processes, the bus, the client, the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from zsight.async_client import AsyncCellClient, connect_async
    from zsight.client import CellClient, connect

__all__ = ["AsyncCellClient", "CellClient", "connect", "connect_async"]


def __getattr__(name: str) -> Any:
    """The client, imported when first asked for: services and commands that need none start faster."""
    if name in ("CellClient", "connect"):
        from zsight import client

        return getattr(client, name)
    if name in ("AsyncCellClient", "connect_async"):
        from zsight import async_client

        return getattr(async_client, name)
    raise AttributeError(f"module zsight has no attribute {name!r}")
