"""Compile every kernel once, before anybody waits for one."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from zsight_core import kernel_cache

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["is_warm", "kernel_modules", "warm"]


def warm(progress: Callable[[str, float], None] | None = None) -> None:
    """Compile the kernels of all modules and keep them for later processes; the first time it takes a minute or so.

    Args:
        progress: called with the name of the module at hand and the fraction done, 0..1; at the end with "" and 1.0.
    """
    modules = kernel_modules()
    for done, name in enumerate(modules):
        if progress is not None:
            progress(name.rpartition(".")[2], done / len(modules))
        import_module(name).warm_up()
    kernel_cache.stamp()
    if progress is not None:
        progress("", 1.0)


def is_warm() -> bool:
    """True where `warm` has run to its end for these sources, this numba and this processor; costs about 1 ms."""
    return kernel_cache.is_stamped()


@cache
def kernel_modules() -> tuple[str, ...]:
    """Names of all modules of this package that define ``warm_up()``: a new one needs no entry anywhere."""
    package = Path(__file__).resolve().parent
    found = [path for path in package.rglob("*.py") if "\ndef warm_up(" in path.read_text(encoding="utf-8")]
    return tuple(sorted(".".join(("zsight_core", *path.relative_to(package).with_suffix("").parts)) for path in found))
