"""Compile every kernel once, before anybody waits for one."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from zsight_core import kernel_cache

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["KERNEL_MODULES", "is_warm", "warm"]

KERNEL_MODULES = (
    "moments",
    "take",
    "voxel_grid",
    "plane",
    "statistics",
    "filters",
    "rigid",
    "table_height",
    "connected",
    "above_plane",
)
"""Modules of this package that define ``warm_up()``; a test compares this list with the modules that import numba."""


def warm(progress: Callable[[str, float], None] | None = None) -> None:
    """Compile the kernels of all modules and keep them for later processes; the first time it takes a minute or so.

    Args:
        progress: called with the name of the module at hand and the fraction done, 0..1; at the end with "" and 1.0.
    """
    for done, name in enumerate(KERNEL_MODULES):
        if progress is not None:
            progress(name, done / len(KERNEL_MODULES))
        import_module(f"zsight_core.{name}").warm_up()
    kernel_cache.stamp()
    if progress is not None:
        progress("", 1.0)


def is_warm() -> bool:
    """True where `warm` has run to its end for these sources, this numba and this processor; costs about 1 ms."""
    return kernel_cache.is_stamped()
