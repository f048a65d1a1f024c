"""Forward kinematics and Jacobian of a serial arm, compiled.

Frames: `base` is the planning frame; joint frame i (1-based) moves with joint i and its z axis is the joint's axis. Poses are the
upper three rows of homogeneous matrices, (3, 4), so that `poses[i]` takes joint frame i into the base frame (`T_base_joint`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array, UInt8


class Chain(NamedTuple):
    """A serial arm of n joints as plain arrays, ready for kernels; built by `make_chain`.

    Attributes:
        placements: (n, 3, 4), joint frame i in joint frame i - 1 (the base for the first) at position 0 [m].
        axes: (n, 3), the joints' axes in their own frames: always (0, 0, 1), which the kernels rely on.
        prismatic: (n,) uint8, 1 for a joint that slides along its axis [m], 0 for one that turns about it [rad].
        tool: (3, 4), the tool frame in the last joint's frame [m].
    """

    placements: Array
    axes: Array
    prismatic: UInt8
    tool: Array


def make_chain(placements: Array, axes: Array, prismatic: UInt8, tool: Array) -> tuple[Chain, Array]:
    """Build a chain from joints with any axes by turning every joint frame until its axis is z.

    Args:
        placements: (n, 3, 4), joint frame i in joint frame i - 1 at position 0, as in the URDF.
        axes: (n, 3), unit axes in those joint frames.
        prismatic: (n,), 1 where the joint slides.
        tool: (3, 4), the tool frame in the last of those frames.

    Returns:
        The chain, and (n, 3, 3) rotations that take coordinates in a given joint frame into the chain's joint frame (the identity
        where the axis was z already).
    """
    n = len(axes)
    turns = np.stack([_z_to(axis) for axis in axes]) if n else np.zeros((0, 3, 3))
    new_placements = np.array(placements, dtype=np.float64)
    for i in range(n):
        if i > 0:
            new_placements[i] = turns[i - 1].T @ new_placements[i]
        new_placements[i, :, :3] = new_placements[i, :, :3] @ turns[i]
    new_tool = turns[-1].T @ np.asarray(tool, dtype=np.float64)
    z = np.tile(np.array([0.0, 0.0, 1.0]), (n, 1))
    kinds = np.ascontiguousarray(prismatic, dtype=np.uint8)
    chain = Chain(np.ascontiguousarray(new_placements), z, kinds, np.ascontiguousarray(new_tool))
    return chain, np.ascontiguousarray(turns.transpose(0, 2, 1))


def _z_to(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is `axis`; the identity for z."""
    z = axis / np.linalg.norm(axis)
    if z[2] > 1.0 - 1e-15:
        return np.eye(3)
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@hot_kernel
def sine_cosine(angle: float) -> tuple[float, float]:
    """Return sine and cosine together, to 3e-16 for |angle| below 1e5 rad.

    Cody-Waite reduction to ±π/4 and the minimax polynomials of the Cephes library (`sin.c`, Moshier). No branch, so that the
    compiler may work on several joints at a time; three times as fast as two calls into the mathematical library.
    """
    turns = np.rint(angle * 0.6366197723675814)
    x = angle - turns * 1.57079625129699707031
    x -= turns * 7.54978941586159635335e-8
    x -= turns * 5.39030252995776476554e-15
    z = x * x
    s = 1.58962301576546568060e-10 * z - 2.50507477628578072866e-8
    s = s * z + 2.75573136213857245213e-6
    s = s * z - 1.98412698295895385996e-4
    s = s * z + 8.33333333332211858878e-3
    s = s * z - 1.66666666666666307295e-1
    s = x + x * z * s
    c = -1.13585365213876817300e-11 * z + 2.08757008419747316778e-9
    c = c * z - 2.75573141792967388112e-7
    c = c * z + 2.48015872888517045348e-5
    c = c * z - 1.38888888888730564116e-3
    c = c * z + 4.16666666666665929218e-2
    c = 1.0 - 0.5 * z + z * z * c
    quadrant = np.int64(turns) & 3
    odd = (quadrant & 1) == 1
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if quadrant >= 2 else sine
    cosine = -cosine if (quadrant == 1) | (quadrant == 2) else cosine
    return sine, cosine


@hot_kernel
def forward_kinematics(chain: Chain, q: Array, poses: Array) -> None:
    """Write the pose of every joint frame.

    Args:
        chain: the arm.
        q: joint positions, (n,) [rad].
        poses: (n + 1, 3, 4) float64, C-contiguous, written: `poses[0]` the identity, `poses[i]` = T_base_joint_i.
    """
    r00, r01, r02, px = 1.0, 0.0, 0.0, 0.0
    r10, r11, r12, py = 0.0, 1.0, 0.0, 0.0
    r20, r21, r22, pz = 0.0, 0.0, 1.0, 0.0
    base = poses[0]
    base[0, 0], base[0, 1], base[0, 2], base[0, 3] = 1.0, 0.0, 0.0, 0.0
    base[1, 0], base[1, 1], base[1, 2], base[1, 3] = 0.0, 1.0, 0.0, 0.0
    base[2, 0], base[2, 1], base[2, 2], base[2, 3] = 0.0, 0.0, 1.0, 0.0
    for i in range(q.shape[0]):
        place = chain.placements[i]
        x, y, z = place[0, 3], place[1, 3], place[2, 3]
        px += r00 * x + r01 * y + r02 * z
        py += r10 * x + r11 * y + r12 * z
        pz += r20 * x + r21 * y + r22 * z
        p00, p10, p20 = place[0, 0], place[1, 0], place[2, 0]
        a0 = r00 * p00 + r01 * p10 + r02 * p20
        a1 = r10 * p00 + r11 * p10 + r12 * p20
        a2 = r20 * p00 + r21 * p10 + r22 * p20
        p00, p10, p20 = place[0, 1], place[1, 1], place[2, 1]
        b0 = r00 * p00 + r01 * p10 + r02 * p20
        b1 = r10 * p00 + r11 * p10 + r12 * p20
        b2 = r20 * p00 + r21 * p10 + r22 * p20
        p00, p10, p20 = place[0, 2], place[1, 2], place[2, 2]
        r02, r12, r22 = (
            r00 * p00 + r01 * p10 + r02 * p20,
            r10 * p00 + r11 * p10 + r12 * p20,
            r20 * p00 + r21 * p10 + r22 * p20,
        )
        if chain.prismatic[i] == 0:
            s, c = sine_cosine(q[i])
            r00, r10, r20 = c * a0 + s * b0, c * a1 + s * b1, c * a2 + s * b2
            r01, r11, r21 = c * b0 - s * a0, c * b1 - s * a1, c * b2 - s * a2
        else:
            r00, r10, r20 = a0, a1, a2
            r01, r11, r21 = b0, b1, b2
            px += r02 * q[i]
            py += r12 * q[i]
            pz += r22 * q[i]
        out = poses[i + 1]
        out[0, 0], out[0, 1], out[0, 2], out[0, 3] = r00, r01, r02, px
        out[1, 0], out[1, 1], out[1, 2], out[1, 3] = r10, r11, r12, py
        out[2, 0], out[2, 1], out[2, 2], out[2, 3] = r20, r21, r22, pz


@hot_kernel
def tool_pose(chain: Chain, poses: Array, out: Array) -> None:
    """Write the tool's pose T_base_tool (3, 4) from the poses of `forward_kinematics`."""
    last = poses[poses.shape[0] - 1]
    tool = chain.tool
    for r in range(3):
        for c in range(4):
            out[r, c] = last[r, 0] * tool[0, c] + last[r, 1] * tool[1, c] + last[r, 2] * tool[2, c]
        out[r, 3] += last[r, 3]


@hot_kernel
def point_jacobian(chain: Chain, poses: Array, joint: int, x: float, y: float, z: float, out: Array) -> None:
    """Write the (3, n) Jacobian of a point at (x, y, z) in the base frame that moves with joint frame `joint` [m/rad].

    Columns of later joints are zero.
    """
    for i in range(out.shape[1]):
        if i >= joint:
            out[0, i], out[1, i], out[2, i] = 0.0, 0.0, 0.0
            continue
        frame = poses[i + 1]
        ax, ay, az = frame[0, 2], frame[1, 2], frame[2, 2]
        if chain.prismatic[i] == 0:
            dx, dy, dz = x - frame[0, 3], y - frame[1, 3], z - frame[2, 3]
            out[0, i], out[1, i], out[2, i] = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
        else:
            out[0, i], out[1, i], out[2, i] = ax, ay, az


@hot_kernel
def tool_jacobian(chain: Chain, poses: Array, out: Array) -> None:
    """Write the tool frame's Jacobian (6, n): linear velocity first [m/rad], then angular [-], both in the base frame's axes."""
    n = out.shape[1]
    last = poses[n]
    tool = chain.tool
    x = last[0, 0] * tool[0, 3] + last[0, 1] * tool[1, 3] + last[0, 2] * tool[2, 3] + last[0, 3]
    y = last[1, 0] * tool[0, 3] + last[1, 1] * tool[1, 3] + last[1, 2] * tool[2, 3] + last[1, 3]
    z = last[2, 0] * tool[0, 3] + last[2, 1] * tool[1, 3] + last[2, 2] * tool[2, 3] + last[2, 3]
    point_jacobian(chain, poses, n, x, y, z, out)
    for i in range(n):
        turning = 0.0 if chain.prismatic[i] else 1.0
        for r in range(3):
            out[3 + r, i] = turning * poses[i + 1, r, 2]


@hot_kernel
def forward_many(chain: Chain, path: Array, poses: Array) -> None:
    """Write the joint frames' poses (K, n + 1, 3, 4) of many configurations (K, n)."""
    for k in range(path.shape[0]):
        forward_kinematics(chain, path[k], poses[k])
