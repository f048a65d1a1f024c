"""Inverse kinematics by continuation, and straight stretches in joint space, compiled.

A tool pose next to one whose configurations are known has its own configurations next to those: a few Newton steps from there find
them, where random starts take fifty times as long. The straight stretch before a grasp is followed in the same way, step by step.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from lime_planner.core.jit import kernel
from lime_planner.core.types import Array
from lime_planner.planning.space import edge, evaluate
from lime_planner.robot.ik import LENGTH_M, pose_error, solve_damped
from lime_planner.robot.kinematics import forward_kinematics, tool_jacobian, tool_pose

# What became of a configuration at a grasp, and of the stretch that leads there.
FREE, CLOSE, BLOCKED, LIMITS, NO_ROOM, BLOCKED_ON_THE_WAY, DEARER = 0, 1, 2, 3, 4, 5, 6

MAX_BRANCHES = 16
CLOSE_COST = 0.5  # of a stretch that comes closer to something hard than the margin [rad]
_CONVERGED = 1e-8  # root of the sum of squared errors [rad, or LENGTH_M]
_SAME_RAD = 0.01
_TURN = 2.0 * math.pi
_LONGEST_STEP_RAD = 0.3  # of a joint within one step of the stretch: more is next to a singularity
_LINE_TOLERANCE_M = 0.0015  # between two steps the tool stays this close to the straight line ...
_TURN_TOLERANCE_RAD = 0.025  # ... and within this of its orientation
_DAMPING = 1e-6
_STUCK = 1e6


class Memory(NamedTuple):
    """Scratch of one thread for an arm of n joints."""

    poses: Array
    tool: Array
    target: Array
    jacobian: Array
    error: Array
    other_error: Array
    normal: Array
    factor: Array
    gradient: Array
    step: Array
    trial: Array
    middle: Array


def make_memory(n: int) -> Memory:
    """Allocate scratch memory."""
    return Memory(
        np.empty((n + 1, 3, 4)),
        np.empty((3, 4)),
        np.empty((3, 4)),
        np.empty((6, n)),
        np.empty(6),
        np.empty(6),
        np.empty((n, n)),
        np.empty((n, n)),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
    )


@kernel
def solve(chain: Any, target: Any, q: Any, iterations: int, most_rad: float, memory: Any) -> bool:
    """Levenberg-Marquardt from q, in place, joint limits ignored.

    Args:
        chain: the arm.
        target: T_base_tool (3, 4).
        q: (n,) where to begin; the solution where the result is True.
        iterations: at most this many steps.
        most_rad: longest step of a joint.
        memory: scratch.

    Returns:
        Whether the pose is reached.
    """
    n = q.shape[0]
    forward_kinematics(chain, q, memory.poses)
    tool_pose(chain, memory.poses, memory.tool)
    cost = pose_error(target, memory.tool, memory.error)
    damping = _DAMPING
    linearised = False
    for _ in range(iterations):
        if cost < _CONVERGED * _CONVERGED:
            return True
        if not linearised:
            tool_jacobian(chain, memory.poses, memory.jacobian)
            for i in range(n):
                for r in range(3):
                    memory.jacobian[r, i] /= LENGTH_M
                memory.gradient[i] = 0.0
                for r in range(6):
                    memory.gradient[i] += memory.jacobian[r, i] * memory.error[r]
                for j in range(i + 1):
                    total = 0.0
                    for r in range(6):
                        total += memory.jacobian[r, i] * memory.jacobian[r, j]
                    memory.normal[i, j] = total
            linearised = True
        if damping > _STUCK:
            return False
        better = solve_damped(memory.normal, damping, memory.gradient, memory.factor, memory.step)
        if better:
            longest = 0.0
            for i in range(n):
                longest = max(longest, abs(memory.step[i]))
            scale = min(1.0, most_rad / longest) if longest > 0.0 else 0.0
            for i in range(n):
                memory.trial[i] = q[i] + scale * memory.step[i]
            forward_kinematics(chain, memory.trial, memory.poses)
            tool_pose(chain, memory.poses, memory.tool)
            trial_cost = pose_error(target, memory.tool, memory.other_error)
            better = trial_cost < cost
            if better:
                for i in range(n):
                    q[i] = memory.trial[i]
                for r in range(6):
                    memory.error[r] = memory.other_error[r]
                stuck = trial_cost > 1e-6 and trial_cost > 0.9999 * cost
                cost = trial_cost
                damping = max(0.1 * damping, 1e-12)
                linearised = False
                if stuck:
                    return False
        if not better:
            damping *= 30.0
    return bool(cost < _CONVERGED * _CONVERGED)


@kernel
def _add_distinct(solutions: Any, count: int, q: Any) -> int:
    """Add q to the first `count` rows unless one of them is the same but for whole turns; the new count."""
    for b in range(count):
        same = True
        for i in range(q.shape[0]):
            apart = (q[i] - solutions[b, i] + math.pi) % _TURN - math.pi
            if abs(apart) > _SAME_RAD:
                same = False
                break
        if same:
            return count
    if count >= solutions.shape[0]:
        return count
    for i in range(q.shape[0]):
        solutions[count, i] = q[i]
    return count + 1


@kernel
def solve_poses(
    chain: Any, targets: Any, first: int, last: int, parents: Any, starts: Any, started: int, solutions: Any, counts: Any, memory: Any
) -> None:
    """Find configurations for the poses `first` to `last`, each from those of poses before it.

    Args:
        chain: the arm.
        targets: (P, 3, 4) T_base_tool.
        first, last: which poses; those before `first` are done.
        parents: (P, K) poses from whose configurations to go on, -1 for none.
        starts: (S, n) random configurations from which the first `started` poses, and those whose parents have none, are tried as well.
        started: see `starts`. A pose that a third of its starts do not reach is given up.
        solutions: (P, MAX_BRANCHES, n) written, limits ignored; counts: (P,) written.
        memory: scratch.
    """
    n = starts.shape[1]
    for p in range(first, last):
        count = 0
        for k in range(parents.shape[1]):
            parent = parents[p, k]
            if parent < 0:
                continue
            for b in range(counts[parent]):
                for i in range(n):
                    memory.middle[i] = solutions[parent, b, i]
                if solve(chain, targets[p], memory.middle, 12, 0.5, memory):
                    count = _add_distinct(solutions[p], count, memory.middle)
        if p < started or count == 0:
            share = starts.shape[0] if p < started else starts.shape[0] // 4
            for s in range(share):
                if count == 0 and 3 * s >= share:  # a pose that can be reached is reached from most starts
                    break
                for i in range(n):
                    memory.middle[i] = starts[s, i]
                if solve(chain, targets[p], memory.middle, 40, 1.0, memory):
                    count = _add_distinct(solutions[p], count, memory.middle)
        counts[p] = count


@kernel
def solve_from(chain: Any, targets: Any, solutions: Any, counts: Any, memory: Any) -> None:
    """Find one configuration for each pose (P, 3, 4), from the one in solutions[p, 0]; counts (P,) tells where there is one."""
    for p in range(targets.shape[0]):
        counts[p] = 1 if solve(chain, targets[p], solutions[p, 0], 20, 0.5, memory) else 0


@kernel
def _apart(q: Any, other: Any) -> float:
    """Length of the straight way between two configurations [rad]."""
    total = 0.0
    for i in range(q.shape[0]):
        total += (q[i] - other[i]) ** 2
    return math.sqrt(total)


@kernel
def unwrap(q: Any, near: Any, lower: Any, upper: Any) -> bool:
    """Take whole turns off each joint of q until it is as near to `near` as the limits allow; False where none is within them."""
    for i in range(q.shape[0]):
        value = q[i] + _TURN * round((near[i] - q[i]) / _TURN)
        if value < lower[i]:
            value += _TURN * math.ceil((lower[i] - value) / _TURN)
        elif value > upper[i]:
            value -= _TURN * math.ceil((value - upper[i]) / _TURN)
        if value < lower[i] or value > upper[i]:
            return False
        q[i] = value
    return True


@kernel
def _off_line(chain: Any, target: Any, q: Any, memory: Any) -> bool:
    """Whether the tool at q is off the line through the target's origin along its z axis, or turned against the target."""
    forward_kinematics(chain, q, memory.poses)
    tool_pose(chain, memory.poses, memory.tool)
    pose_error(target, memory.tool, memory.error)
    along = 0.0
    total = 0.0
    for r in range(3):
        gap = LENGTH_M * memory.error[r]
        along += gap * target[r, 2]
        total += gap * gap
    turn = math.sqrt(memory.error[3] ** 2 + memory.error[4] ** 2 + memory.error[5] ** 2)
    return bool(total - along * along > _LINE_TOLERANCE_M * _LINE_TOLERANCE_M or turn > _TURN_TOLERANCE_RAD)


@kernel
def step_back(chain: Any, target: Any, distance_m: float, nodes: Any, k: int, lower: Any, upper: Any, memory: Any) -> bool:
    """Find node k of a stretch, `distance_m` behind the target along its z axis, from nodes 0 to k - 1; False where there is none.

    The tool keeps to the line between two nodes as well, within the tolerances above.
    """
    n = nodes.shape[1]
    for r in range(3):
        for c in range(4):
            memory.target[r, c] = target[r, c]
        memory.target[r, 3] -= distance_m * target[r, 2]
    q = nodes[k]
    for i in range(n):
        q[i] = 2.0 * nodes[k - 1, i] - nodes[k - 2, i] if k >= 2 else nodes[k - 1, i]
    if not solve(chain, memory.target, q, 12, _LONGEST_STEP_RAD, memory):
        return False
    for i in range(n):
        if not lower[i] <= q[i] <= upper[i] or abs(q[i] - nodes[k - 1, i]) > _LONGEST_STEP_RAD:
            return False
        memory.middle[i] = 0.5 * (q[i] + nodes[k - 1, i])
    return not _off_line(chain, target, memory.middle, memory)


@kernel
def _leaf_at(space: Any, near_space: Any, q: Any) -> tuple[float, bool]:
    """Leaf intensity at q and whether q is closer to something hard than the margin; -1 where it is closer than certifiable."""
    leaf = evaluate(space, q)
    if leaf >= 0.0:
        return leaf, False
    return evaluate(near_space, q), True


@kernel
def stretch_back(
    space: Any,
    near_space: Any,
    chain: Any,
    target: Any,
    length_m: float,
    least_m: float,
    lower: Any,
    upper: Any,
    nodes: Any,
    weight: float,
    start: Any,
    bound: float,
    memory: Any,
    figures: Any,
) -> Any:
    """Go back from the grasp in nodes[0] in straight steps, and look at each of them.

    Args:
        space: the arm among obstacles, with the margin; near_space: the same with the least clearance that can be certified.
        chain: the arm.
        target: (3, 4) T_base_tool at the grasp.
        length_m: of the whole stretch; nodes.shape[0] - 1 equal steps.
        least_m: a stretch shorter than this does not count.
        lower, upper: (n,) limits of the joints.
        nodes: (K + 1, n) written from 1 on.
        weight: leaf weight of J.
        start: (n,) where the arm is.
        bound: what the stretch and the shortest way from the start to where it begins may cost together.
        memory: scratch.
        figures: (3,) written: nodes that are good, an estimate of J along the stretch, leaf intensity at the grasp.

    Returns:
        FREE, CLOSE (somewhere closer than the margin), or why not: BLOCKED at the grasp, LIMITS, NO_ROOM for the arm to move straight,
        BLOCKED_ON_THE_WAY, DEARER than the bound (whether it is free is not known then).
    """
    n = nodes.shape[1]
    steps = nodes.shape[0] - 1
    figures[0], figures[1], figures[2] = 0.0, 0.0, 0.0
    for i in range(n):
        if not lower[i] <= nodes[0, i] <= upper[i]:
            return LIMITS
    if not _apart(nodes[0], start) < bound:
        return DEARER
    before, near = _leaf_at(space, near_space, nodes[0])
    if before < 0.0:
        return BLOCKED
    figures[0], figures[2] = 1.0, before
    code = CLOSE if near else FREE
    for k in range(1, steps + 1):
        distance_m = length_m * k / steps
        why = FREE
        if not step_back(chain, target, distance_m, nodes, k, lower, upper, memory):
            why = NO_ROOM
        else:
            leaf, near = _leaf_at(space, near_space, nodes[k])
            if leaf < 0.0:
                why = BLOCKED_ON_THE_WAY
        if why != FREE:
            return code if length_m * (k - 1) / steps >= least_m - 1e-9 else why
        figures[1] += _apart(nodes[k], nodes[k - 1]) * (1.0 + 0.5 * weight * (before + leaf))
        if not figures[1] + _apart(nodes[k], start) < bound:  # both cannot get less from here on: the rest has a length
            return DEARER
        figures[0] = k + 1.0
        before = leaf
        if near:
            code = CLOSE
    return code


@kernel
def begin(solutions: Any, counts: Any, near: Any, lower: Any, upper: Any, nodes: Any, ways: Any) -> None:
    """Put every configuration, unwrapped near the configuration `near` (n,), at the begin of its stretch.

    Writes nodes (P, B, K + 1, n) at K = 0, and ways (P, B) from `near` where one is within limits.
    """
    for p in range(solutions.shape[0]):
        for b in range(counts[p]):
            for i in range(near.shape[0]):
                nodes[p, b, 0, i] = solutions[p, b, i]
            if unwrap(nodes[p, b, 0], near, lower, upper):
                ways[p, b] = _apart(nodes[p, b, 0], near)


@kernel
def look_at(
    space: Any,
    near_space: Any,
    chain: Any,
    targets: Any,
    rows: Any,
    near: Any,
    length_m: float,
    least_m: float,
    missing_cost: float,
    lower: Any,
    upper: Any,
    weight: float,
    memory: Any,
    nodes: Any,
    figures: Any,
    codes: Any,
    totals: Any,
    cheapest: Any,
) -> None:
    """`stretch_back` for some configurations, as long as they may be among the cheapest.

    Args:
        space, near_space, chain, length_m, least_m, lower, upper, weight, memory: see `stretch_back`.
        targets: (P, 3, 4).
        rows: (M, 2) pose and branch of each.
        near: (n,) where the arm is.
        missing_cost: for each step that a stretch is shorter than wanted.
        nodes: (P, B, K + 1, n), begun; figures: (P, B, 3) and codes: (P, B) written.
        totals: (P, B) written where free: what stretch and shortest way there cost.
        cheapest: (C,) the least of all totals, ascending, inf where there are fewer; kept up to date. Its last one is the bound; where
            it is empty there is none.
    """
    last = cheapest.shape[0] - 1
    for p, b in rows:
        bound = cheapest[last] if last >= 0 else np.inf
        code = stretch_back(
            space,
            near_space,
            chain,
            targets[p],
            length_m,
            least_m,
            lower,
            upper,
            nodes[p, b],
            weight,
            near,
            bound,
            memory,
            figures[p, b],
        )
        codes[p, b] = code
        if code != FREE and code != CLOSE:
            continue
        count = int(figures[p, b, 0])
        total = figures[p, b, 1] + missing_cost * (nodes.shape[2] - count) + _apart(nodes[p, b, count - 1], near)
        if code == CLOSE:
            total += CLOSE_COST
        totals[p, b] = total
        if last >= 0 and total < bound:
            place = last
            while place > 0 and cheapest[place - 1] > total:
                cheapest[place] = cheapest[place - 1]
                place -= 1
            cheapest[place] = total


@kernel
def price(space: Any, nodes: Any, count: int, weight: float, bound: float) -> Any:
    """J of a stretch over its first `count` nodes, certified along every edge; inf where it is blocked, more than `bound` where dearer."""
    total = 0.0
    for k in range(count - 1, 0, -1):
        total += edge(space, nodes[k], nodes[k - 1], weight, bound - total)
        if not total <= bound:
            return total
    return total
