"""Numba's ``njit`` for the kernels of this package: each type compiled once, and loaded without the compiler."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar, cast

import numba

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["is_quick", "njit"]

F = TypeVar("F", bound="Callable[..., Any]")


def is_quick() -> bool:
    """True with the numba whose inside `kernel_loading` was written for; with another one all is as it has it."""
    return bool(numba.__version__.startswith("0.68.") and not numba.config.DISABLE_JIT)


def njit(**options: Any) -> Callable[[F], F]:
    """As numba's; ``cache=True`` is among the options of every kernel.

    A number that stands in a call is of the same type as one that does not: numba would compile what is called once
    more for it, and the machine code would not be faster. And no kernel can be called from C.
    """

    def kernel_of(function: F) -> F:
        if not is_quick():
            return cast("F", numba.njit(**options)(function))
        from zsight_core.kernel_loading import KernelCache, plain

        kernel = numba.njit(**(options | {"cache": False, "no_cfunc_wrapper": True}))(function)
        kernel._cache = KernelCache(function)  # noqa: SLF001  # numba has no public way to say how its cache is read
        typed = kernel.get_call_template
        kernel.get_call_template = lambda args, named: typed(
            tuple(map(plain, args)), {name: plain(kind) for name, kind in named.items()}
        )
        return cast("F", kernel)

    return kernel_of
