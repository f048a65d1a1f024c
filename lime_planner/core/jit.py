"""One decorator for every compiled kernel, with an on-disk cache that cannot go stale (`lime_planner.core.kernel_cache`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from lime_planner.core.errors import LimePlannerError
from lime_planner.core.kernel_cache import kernel_cache, use_kernel_files
from lime_planner.core.kernel_parts import with_part

if numba.config.DISABLE_JIT:
    raise LimePlannerError("NUMBA_DISABLE_JIT is set, and without the compiler nothing can be planned: unset it")

F = TypeVar("F", bound=Callable[..., Any])

#: Compiler options of every kernel: no GIL (services stay responsive), NaN and inf kept meaningful, fused multiply-add.
JIT_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": {"contract", "nsz"}}


def _compiled(function: F, **options: Any) -> F:
    options = {**JIT_OPTIONS, **options}
    with kernel_cache(function):
        compiled = use_kernel_files(numba.njit(cache=True, no_cfunc_wrapper=True, **options)(function))
    return with_part(compiled, function, options)  # type: ignore[no-any-return]


def kernel(function: F) -> F:
    """Compile `function` with Numba: no Python objects, no GIL, cached on disk under a hash of the sources it is made of."""
    return _compiled(function)


def hot_kernel(function: F) -> F:
    """Compile like `kernel`, but without reference counts: for the innermost functions, which take and pass on many arrays.

    Counting references of the arrays inside a named tuple costs atomic additions at every call, several times the work itself.
    Such a function must not allocate or return arrays; its callers keep them alive.
    """
    return _compiled(function, _nrt=False)


def inline_kernel(function: F) -> F:
    """Compile like `hot_kernel`, but merged into each caller, so that named tuples of many arrays are not copied at the call."""
    return _compiled(function, forceinline=True, _nrt=False)


def c_function(signature: Any, function: Callable[..., Any]) -> Any:
    """Compile `function` as a C function with an address (slow the first time, then read from the cache; keep the result alive)."""
    with kernel_cache(function):
        return use_kernel_files(numba.cfunc(signature, cache=True, _nrt=False, **JIT_OPTIONS)(function))


@inline_kernel
def copy_row(source: Any, target: Any) -> None:
    """Copy (n,) numbers inside a kernel; `target[:] = source` brings text for errors of shape along, which takes seconds to compile."""
    for i in range(target.shape[0]):
        target[i] = source[i]
