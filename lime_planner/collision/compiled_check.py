"""The collision check behind an address: compiled once, called by every planner without being compiled into it.

The check is large. Numba would merge it into each kernel that uses it and compile it again there, minutes in all. Here it is one C
function; what it needs is a structure in memory, written once for each thread, and planners pass that structure's address.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numba
import numba.core.types as nt
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.extending import intrinsic

from lime_planner.collision.distance_fields import build_fields
from lime_planner.collision.fast import Scratch, State, check, make_scratch, make_state
from lime_planner.collision.leaf_contact import charged_between
from lime_planner.collision.link_shapes import Shapes
from lime_planner.collision.potential import repulse
from lime_planner.collision.world import World, empty_world
from lime_planner.core.jit import c_function, kernel
from lime_planner.core.types import Int64
from lime_planner.robot.kinematics import Chain


class Parts(NamedTuple):
    """Everything that the check needs, in the order in which it lies in memory."""

    chain: Chain
    shapes: Shapes
    world: World
    scratch: Scratch
    state: State


def _example() -> Parts:
    """Parts of the right types and no content."""
    chain = Chain(np.zeros((0, 3, 4)), np.zeros((0, 3)), np.zeros(0, np.uint8), np.zeros((3, 4)))
    whole, real, rows = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 4))
    shapes = Shapes(
        origin=np.zeros((0, 3)),
        spacing=real,
        size=np.zeros((0, 3), np.int64),
        offset=whole,
        grid=np.zeros(0, np.float32),
        bound=rows,
        coarse=rows,
        coarse_start=whole,
        fine=rows,
        fine_start=whole,
        surface=np.zeros((0, 3)),
        surface_start=whole,
        pairs=np.zeros((0, 2), np.int64),
        lever=np.zeros((0, 0)),
        gripper=0,
    )
    fields = build_fields(np.zeros((0, 3)), np.zeros((0, 3)))
    return Parts(chain, shapes, empty_world(fields, 0), make_scratch(shapes, fields), make_state(shapes))


_TYPE = numba.typeof(_example())


@intrinsic
def _write(typing_context: Any, parts: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = builder.inttoptr(values[1], context.get_value_type(parts).as_pointer())
        builder.store(values[0], pointer)
        return context.get_dummy_value()

    return nt.void(parts, nt.int64), generate


@intrinsic
def _read(typing_context: Any, address: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load(builder.inttoptr(values[0], context.get_value_type(_TYPE).as_pointer()))

    return _TYPE(nt.int64), generate


@intrinsic
def _size(typing_context: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return context.get_constant(nt.int64, context.get_abi_sizeof(context.get_value_type(_TYPE)))

    return nt.int64(), generate


@kernel
def _write_parts(parts: Any, address: int) -> None:
    _write(parts, address)


@kernel
def _parts_size() -> Any:
    return _size()


def _check_at(handle: Any, leaves: Any, floor: Any) -> Any:
    parts = _read(handle)
    return 1 if check(parts.chain, parts.shapes, parts.world, parts.scratch, parts.scratch.q, leaves != 0, floor, parts.state) else 0


def _charge_at(handle: Any, finest: Any, enough: Any) -> Any:
    parts = _read(handle)
    return charged_between(parts.chain, parts.shapes, parts.world, parts.scratch, finest, enough)


def _repulse_at(handle: Any, d_star: Any, k_leaf: Any, k_stem: Any) -> Any:
    parts = _read(handle)
    check(parts.chain, parts.shapes, parts.world, parts.scratch, parts.scratch.q, False, -np.inf, parts.state)
    touching = False
    for b in range(parts.state.clear.shape[0]):
        touching = touching or parts.state.clear[b] <= 0.0
    return repulse(parts, touching, d_star, k_leaf, k_stem, parts.scratch.force)


@functools.cache
def functions() -> tuple[Any, Any, Any]:
    """The C functions, compiled on first use.

    check(handle, leaves, floor), repulsion(handle, d*, K_leaf, K_stem), charge(handle, finest, enough).
    """
    real, whole = nt.float64, nt.int64
    return (
        c_function(whole(whole, whole, real), _check_at),
        c_function(real(whole, real, real, real), _repulse_at),
        c_function(real(whole, real, real), _charge_at),
    )


class _Memory:
    """The structure in memory; an array made of it keeps alive what it points to."""

    def __init__(self, parts: Parts) -> None:
        self.kept = (parts, functions())
        self.buffer = np.zeros(_parts_size() // 8 + 8)
        _write_parts(parts, self.buffer.ctypes.data)
        self.addresses = np.array([self.buffer.ctypes.data, *(function.address for function in functions())], np.int64)
        self.__array_interface__ = self.addresses.__array_interface__


def make_engine(chain: Chain, shapes: Shapes, world: World, scratch: Scratch, state: State) -> Int64:
    """Return (4,) addresses: of the structure, the check, the repulsion and the charge for leaves; the array keeps everything alive.

    Raises:
        TypeError: an array of another type than compiled code expects (a defect).
    """
    parts = Parts(chain, shapes, world, scratch, state)
    given = numba.typeof(parts)
    if given != _TYPE:
        wrong = [f"{name}: {a} instead of {b}" for name, a, b in zip(Parts._fields, given.types, _TYPE.types, strict=True) if a != b]
        raise TypeError("; ".join(wrong))
    return np.asarray(_Memory(parts))


@intrinsic
def call_check(typing_context: Any, address: Any, handle: Any, leaves: Any, floor: Any) -> Any:
    """Call the check at an address: (address, handle, leaves as 0 or 1, floor) -> 0 or 1."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        whole, real = ir.IntType(64), ir.DoubleType()
        kind = ir.FunctionType(whole, [whole, whole, real])
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])

    return nt.int64(nt.int64, nt.int64, nt.int64, nt.float64), generate


@intrinsic
def call_repulsion(typing_context: Any, address: Any, handle: Any, d_star: Any, k_leaf: Any, k_stem: Any) -> Any:
    """Call the repulsion at an address: (address, handle, d*, K_rep of leaves, K_rep of stems) -> distance."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        whole, real = ir.IntType(64), ir.DoubleType()
        kind = ir.FunctionType(real, [whole, real, real, real])
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])

    return nt.float64(nt.int64, nt.int64, nt.float64, nt.float64, nt.float64), generate


@intrinsic
def call_charge(typing_context: Any, address: Any, handle: Any, finest: Any, enough: Any) -> Any:
    """Call the charge for leaves at an address: (address, handle, finest, enough) -> charge."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        whole, real = ir.IntType(64), ir.DoubleType()
        kind = ir.FunctionType(real, [whole, real, real])
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])

    return nt.float64(nt.int64, nt.int64, nt.float64, nt.float64), generate
