"""How kernels are loaded from numba's cache, as soon as their machine code is there.

Before it loads a cached function numba imports all that a compiler may need (200 modules), reads, for each function,
the intermediate code that only a caller yet to be compiled would need, and imports the modules of all that was compiled
into it. For the kernels of a finder that is 0.4 s of processor time. Here it waits until something is compiled
(docs/decisions/0064). This reaches into numba, and `jit.is_quick` says into which.
"""

from __future__ import annotations

import builtins
import sys
from typing import Any

from llvmlite import binding as llvm
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.environment import Environment, lookup_environment
from numba.core.runtime import rtsys
from numba.core.types.misc import unliteral as plain

__all__ = ["KernelCache", "plain"]


class KernelCache(FunctionCache):  # type: ignore[misc]  # numba is untyped, and so is all that follows
    """Writes and finds kernels as numba does; only the memory that they allocate is made ready before one is loaded."""

    class _impl_class(CompileResultCacheImpl):  # type: ignore[misc]  # noqa: N801  # the name by which numba asks
        def reduce(self, compiled: CompileResult) -> tuple[Any, ...]:
            """What is kept: as by numba, but without the kernel's types in words, and of its parts the names."""
            *kept, _annotation, reload_init, environments = super().reduce(compiled)
            return *kept, reload_init, [(each.globals["__name__"], each.consts, each.env_name) for each in environments]

        def rebuild(self, target: Any, payload: Any) -> CompileResult:
            """A kernel out of what numba kept of it."""
            return _rebuilt(target, *payload)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel for these types, or None."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """Machine code that is there, and the code in between for whoever is compiled later and calls it."""

    bitcode = b""
    _shared_module: Any

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            self._shared_module = llvm.parse_bitcode(self.bitcode)
        return self._shared_module


def _rebuilt(
    target: Any,
    library_data: Any,
    described: Any,
    environment: Any,
    signature: Any,
    in_object_mode: bool,
    lifted: Any,
    reload_init: Any,
    environments: Any,
) -> CompileResult:
    """As `CompileResult` does it itself, but for the library; the arguments are in the order in which they are kept."""
    for initialise in reload_init:
        initialise()
    codegen = target.codegen()
    library = _loaded(codegen, described.llvm_cpython_wrapper_name, *library_data)
    entry_point = target.get_executable(library, described, environment)
    known = [_environment(*each) for each in environments]
    for each in known:
        codegen.set_env(each.env_name, each)
    return CompileResult(
        target_context=target,
        typing_context=target.typing_context,
        library=library,
        environment=environment,
        entry_point=entry_point,
        fndesc=described,
        type_annotation="",
        signature=signature,
        objectmode=in_object_mode,
        lifted=lifted,
        typing_error=None,
        call_helper=None,
        metadata=None,
        reload_init=reload_init,
        referenced_envs=known,
    )


def _environment(module: str, constants: list[Any], name: str) -> Environment:
    """What a function within a kernel refers to; numba would import its module, which only code in Python needs."""
    found = lookup_environment(name)
    if found is None:
        found = Environment(vars(sys.modules.get(module, builtins)))
        found.consts[:] = constants
        found.env_name = name
        Environment._memo[name] = found  # noqa: SLF001  # one of each name
    return found


def _loaded(codegen: Any, entry: str, name: str, _kind: str, data: tuple[bytes, bytes]) -> _Library:
    """A library out of its machine code.

    Args:
        codegen: of the target.
        entry: the symbol that Python calls; its address is asked for by name.
        name: of the library.
        data: machine code, and the code in between.
    """
    library = _Library(codegen, name)
    machine_code, library.bitcode = data
    library.enable_object_caching()
    library._set_compiled_object(machine_code)  # noqa: SLF001  # what numba's own loading does
    library._finalize_final_module()  # noqa: SLF001
    codegen._engine._defined_symbols.add(entry)  # noqa: SLF001
    return library
