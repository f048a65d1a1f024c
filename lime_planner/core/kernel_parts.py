"""Kernels as parts of other kernels: typed and lowered once, optimised only where they end up, never made into machine code alone.

Numba compiles a function that another one calls as if it were called from Python too: wrappers that take apart named tuples of a
hundred arrays, all of LLVM's passes, machine code, a file in the cache. The caller then links the optimised code in, and optimises it
again. Here each kernel has a twin for callers that are compiled themselves. It has no wrappers, is linked into its callers as it was
lowered, and is written to no file; the kernel itself is compiled only if Python calls it. That is less than half of the work in all.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numba
import numba.core.types as nt
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher

_numbers = itertools.count()


class _NoMachineCode:
    """Numba's code generator, to a library that has no machine code in which a function's environment could be set."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, environment: Any) -> None:
        pass


class _Part(JITCodeLibrary):
    """A library that is only linked into others: what it links itself comes along, nothing is optimised, nothing can be run."""

    @property
    def codegen(self) -> Any:
        return _NoMachineCode(self._codegen)

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0


class _PartCompiler(Compiler):
    """Numba's compiler, writing into a library of the kind above."""

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        super().__init__(typingctx, targetctx, _Part(targetctx.codegen(), f"part{next(_numbers)}"), *rest)


def _plain(given: Any) -> Any:
    """The type that a part is compiled for where it is given another: not for each constant and each size of number anew."""
    given = nt.unliteral(given)
    if isinstance(given, nt.Integer) and given.signed:
        return nt.int64
    return nt.float64 if given == nt.float32 else given


class _PartDispatcher(CPUDispatcher):
    """What compiled callers are typed with."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(tuple(map(_plain, args)), {name: _plain(given) for name, given in kws.items()})


class Kernel(CPUDispatcher):
    """A compiled function that Python calls itself, and of which compiled code calls the twin."""

    part: Dispatcher

    @property
    def _numba_type_(self) -> Any:
        return nt.Dispatcher(self.part)


def with_part(compiled: Any, function: Callable[..., Any], options: dict[str, Any]) -> Any:
    """Give a function that Numba has decorated a twin for callers that are compiled themselves, and return it.

    Args:
        compiled: what `numba.njit` returned.
        function: what it was given, and its compiler options.
    """
    compiled.__class__ = Kernel
    compiled.part = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=_PartCompiler, **options)(function)
    compiled.part.__class__ = _PartDispatcher
    return compiled
