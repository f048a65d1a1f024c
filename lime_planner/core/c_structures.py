"""Tuples of arrays as C structures in memory, so that compiled functions can be called by address and given one pointer.

Numba compiles a function again for every type of its arguments, and passes a tuple of arrays by value: seven numbers for each array. A
function that takes the address of a structure is compiled once, its callers pass one number, and it reads the tuple back.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numba
import numba.core.types as nt
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from lime_planner.core.types import UInt8


def _fields(numba_type: Any, at: int) -> Iterator[tuple[int, str]]:
    """Where the numbers of a structure at an offset lie, and their formats, in order."""
    context = cpu_target.target_context
    if isinstance(numba_type, nt.Array):
        yield at, f"{5 + 2 * numba_type.ndim}q"
    elif isinstance(numba_type, nt.BaseTuple):
        end = at
        for part in numba_type.types:
            layout = context.get_value_type(part)
            alignment = layout.get_abi_alignment(context.target_data)
            begin = -(-end // alignment) * alignment
            yield from _fields(part, begin)
            end = begin + context.get_abi_sizeof(layout)
    else:
        formats = {nt.int64: "q", nt.float64: "d", nt.boolean: "?"}
        if numba_type not in formats:
            raise TypeError(f"a {numba_type} has no place in a structure")
        yield at, formats[numba_type]


@functools.cache
def _layout(numba_type: Any) -> struct.Struct:
    """The structure that compiled code has for a type; asking LLVM for it takes a hundred times as long as filling it."""
    form, end = "=", 0
    for at, numbers in _fields(numba_type, 0):
        form += f"{at - end}x{numbers}"
        end = at + struct.calcsize(f"={numbers}")
    context = cpu_target.target_context
    return struct.Struct(f"{form}{context.get_abi_sizeof(context.get_value_type(numba_type)) - end}x")


def _numbers(value: Any) -> Iterator[Any]:
    """What the fields of a structure hold, in order."""
    if isinstance(value, np.ndarray):
        # meminfo, parent (none: compiled code holds no references), items, item size, data, shape, strides
        yield from (0, 0, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides)
    elif isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)
    else:
        yield value


#: Layouts by the identity of the expected type, which is kept with them, and what values of that type look like.
_LAYOUTS: dict[tuple[int, Any], tuple[Any, struct.Struct]] = {}


def _looks(value: Any) -> Any:
    """What decides a value's compile-time type: found in a tenth of the time that Numba needs to name that type."""
    if isinstance(value, np.ndarray):
        flags = value.flags
        return value.dtype, value.ndim, flags.c_contiguous, flags.f_contiguous, flags.writeable, flags.aligned
    return (type(value), *map(_looks, value)) if isinstance(value, tuple) else type(value)


def to_memory(value: Any, expected: Any) -> UInt8:
    """Write a named tuple of arrays, numbers and such tuples as the structure that compiled code has for it.

    Args:
        value: the tuple. What its arrays point to must stay alive as long as the structure is used.
        expected: its compile-time type, as the reader of the structure expects it.

    Returns:
        The structure's bytes; their address is `.ctypes.data`.

    Raises:
        TypeError: the tuple has another type (a defect).
    """
    key = id(expected), _looks(value)
    if key not in _LAYOUTS:
        _LAYOUTS[key] = expected, _checked_layout(value, expected)
    layout = _LAYOUTS[key][1]
    memory = np.zeros(layout.size // 8 + 2, np.int64).view(np.uint8)  # aligned to 8 bytes, which is all that the parts need
    layout.pack_into(memory.data, 0, *_numbers(value))
    return memory


def _checked_layout(value: Any, expected: Any) -> struct.Struct:
    given = numba.typeof(value)
    if given != expected:
        pairs = zip(type(value)._fields, given.types, expected.types, strict=True)
        raise TypeError("; ".join(f"{name}: {a} instead of {b}" for name, a, b in pairs if a != b) or f"{given} instead of {expected}")
    return _layout(expected)


def reader(type_of: Callable[[], Any]) -> Any:
    """Return a function for compiled code that reads a structure from its address (int64).

    Args:
        type_of: gives the structure's compile-time type; asked when code is compiled.
    """

    @intrinsic
    def read(typing_context: Any, address: Any) -> Any:
        numba_type = type_of()

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return builder.load(builder.inttoptr(values[0], context.get_value_type(numba_type).as_pointer()))

        return numba_type(nt.int64), generate

    return read


def caller(result: Any, kinds: str) -> Any:
    """Return a function for compiled code that calls a C function: f(address, *arguments).

    Args:
        result: compile-time type of what it returns, float64 or int64.
        kinds: of the arguments, a letter each: d (float64) or i (int64, or an address).
    """
    types = {"d": ir.DoubleType(), "i": ir.IntType(64)}
    given = tuple(nt.float64 if kind == "d" else nt.int64 for kind in kinds)
    function_type = ir.FunctionType(types["d" if result == nt.float64 else "i"], [types[kind] for kind in kinds])

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        function = builder.inttoptr(values[0], function_type.as_pointer())
        return builder.call(function, cgutils.unpack_tuple(builder, values[1]))

    @intrinsic
    def call(typing_context: Any, address: Any, *arguments: Any) -> Any:
        return result(nt.int64, nt.StarArgTuple(given)), generate

    return call


@intrinsic
def vector(typing_context: Any, address: Any, n: Any) -> Any:
    """The n float64 numbers at an address, as an array (n,) for compiled code; their owner keeps them alive."""
    array_type = nt.Array(nt.float64, 1, "C")

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array = context.make_array(array_type)(context, builder)
        data = builder.inttoptr(values[0], context.get_value_type(nt.float64).as_pointer())
        size = context.get_constant(nt.intp, 8)
        populate_array(array, data=data, shape=[values[1]], strides=[size], itemsize=size, meminfo=None)
        return array._getvalue()

    return array_type(nt.int64, nt.int64), generate


@intrinsic
def address_of(typing_context: Any, configuration: Any) -> Any:
    """The address of a configuration's numbers, the inverse of `vector`: of a contiguous float64 array (n,), in compiled code."""
    array_type = configuration
    if not (isinstance(array_type, nt.Array) and array_type.layout == "C" and array_type.ndim == 1 and array_type.dtype == nt.float64):
        raise numba.TypingError(f"a configuration must be a contiguous float64 array (n,), got {array_type}")

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array = context.make_array(array_type)(context, builder, values[0])
        return builder.ptrtoint(array.data, ir.IntType(64))

    return nt.int64(array_type), generate
