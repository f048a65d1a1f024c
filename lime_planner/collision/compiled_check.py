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

from lime_planner.collision.distance_fields import build_fields
from lime_planner.collision.fast import Scratch, State, check, make_scratch, make_state
from lime_planner.collision.leaves.charge import charged_between
from lime_planner.collision.link_shapes import Shapes
from lime_planner.collision.potential import repulse
from lime_planner.collision.world import World, empty_world
from lime_planner.core.c_structures import caller, reader, to_memory
from lime_planner.core.jit import c_function
from lime_planner.core.types import Int64
from lime_planner.robot.kinematics import Chain


class Parts(NamedTuple):
    """Everything that the check needs, in the order in which it lies in memory."""

    chain: Chain
    shapes: Shapes
    world: World
    scratch: Scratch
    state: State


def empty_parts() -> Parts:
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


@functools.cache
def _type() -> Any:
    return numba.typeof(empty_parts())


_read = reader(_type)

#: Call the check at an address: (address, handle, leaves as 0 or 1, floor) -> 0 or 1.
call_check = caller(nt.int64, "iid")

#: Call the repulsion at an address: (address, handle, address of the check, d*, K_rep of leaves, K_rep of stems) -> distance.
call_repulsion = caller(nt.float64, "iiddd")

#: Call the charge for leaves at an address: (address, handle, finest, enough) -> charge.
call_charge = caller(nt.float64, "idd")


def _check_at(handle: Any, leaves: Any, floor: Any) -> Any:
    parts = _read(handle)
    return 1 if check(parts.chain, parts.shapes, parts.world, parts.scratch, parts.scratch.q, leaves != 0, floor, parts.state) else 0


def _repulse_at(handle: Any, check_at: Any, d_star: Any, k_leaf: Any, k_stem: Any) -> Any:
    parts = _read(handle)
    call_check(check_at, handle, 0, -np.inf)  # by its address: it is compiled once
    nearest = np.inf
    for b in range(parts.state.clear.shape[0]):
        nearest = min(nearest, parts.state.clear[b])
    return repulse(parts, nearest <= 0.0, d_star, k_leaf, k_stem, parts.scratch.force)


def _charge_at(handle: Any, finest: Any, enough: Any) -> Any:
    parts = _read(handle)
    return charged_between(parts.chain, parts.shapes, parts.world, parts.scratch, finest, enough)


@functools.cache
def functions() -> tuple[Any, Any, Any]:
    """The C functions, compiled on first use.

    check(handle, leaves, floor), repulsion(handle, check, d*, K_leaf, K_stem), charge(handle, finest, enough).
    """
    real, whole = nt.float64, nt.int64
    return (
        c_function(whole(whole, whole, real), _check_at),
        c_function(real(whole, whole, real, real, real), _repulse_at),
        c_function(real(whole, real, real), _charge_at),
    )


class _Memory:
    """The structure in memory; an array made of it keeps alive what it points to."""

    def __init__(self, parts: Parts) -> None:
        self.kept = (parts, functions(), to_memory(parts, _type()))
        self.addresses = np.array([self.kept[2].ctypes.data, *(function.address for function in functions())], np.int64)
        self.__array_interface__ = self.addresses.__array_interface__


def make_engine(chain: Chain, shapes: Shapes, world: World, scratch: Scratch, state: State) -> Int64:
    """Return (4,) addresses: of the structure, the check, the repulsion and the charge for leaves; the array keeps everything alive.

    Raises:
        TypeError: an array of another type than compiled code expects (a defect).
    """
    return np.asarray(_Memory(Parts(chain, shapes, world, scratch, state)))
