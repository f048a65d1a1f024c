"""From a target to pre-grasp configurations: which approaches are free, and what their straight stretches cost.

An approach is a pose of the tool at the target. Cheap refusals come first: the hand alone against everything hard needs no
configuration and settles most. Inverse kinematics goes on from the configurations of approaches nearby, the straight stretch is followed
backwards from each solution, and where stretches are cheap more approaches are tried (successive halving). The search then gets the
configurations where stretches begin as its goals, and what the stretches cost as the goals' terminal costs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lime_planner.collision.fast import make_scratch, make_state
from lime_planner.collision.hand import hand_clearances
from lime_planner.core.types import Array, Bool, Int64
from lime_planner.pipeline.context import ask, never
from lime_planner.pipeline.goals import ARM_BLOCKED, FREE, HAND_BLOCKED, MODEL_ERROR_M, NO_ROOM, OUT_OF_REACH, Approaches
from lime_planner.pipeline.grasps import kernels
from lime_planner.pipeline.grasps.approaches import around, in_cone, nearest_earlier, spread
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.targets import Target
from lime_planner.robot.model import Robot

STEP_M = 0.01  # of a stretch
MISSING_COST = 1e4  # per metre that a stretch is shorter than wanted [rad/m]
CLOSE_COST = 0.5  # of a stretch that comes closer to something hard than the margin [rad]

_STATIONS = 4  # places of the hand on the shortest stretch that counts
_FIRST_SHARE = 0.6  # of the approaches are spread evenly; the rest falls near the cheapest
_ROUNDS = 2  # of such
_PARENTS = 24  # cheapest configurations around which more are tried in the first of them; then half as many
_TURN_RAD = 0.25  # how far from them, in the first round; then half as far
_STARTED, _STARTS = 4, 48  # approaches, and random starts for each, with which inverse kinematics begins
_IN_ONE_GO = 24  # approaches between two looks at whether to stop
_PRICED = 4  # times as many stretches as goals are wanted are certified
_APART_RAD = 0.2  # between two goals
_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Grasps:
    """Free grasps, cheapest first.

    Attributes:
        stretches: (G, K + 1, n) configurations from the grasp backwards; the first `counts` of each count [rad].
        counts: (G,) at least 1.
        costs: (G,) J of the stretch with what is added for what it lacks.
        approach: (G,) which approach each belongs to.
        approaches: all that were tried.
    """

    stretches: Array
    counts: Int64
    costs: Array
    approach: Int64
    approaches: Approaches


class _Trials:
    """The approaches of one plan: solved, looked at, priced."""

    def __init__(
        self, obstacles: Obstacles, q_start: Array, rng: np.random.Generator, least_m: float, should_stop: Callable[[], bool]
    ) -> None:
        robot, settings = obstacles.robot, obstacles.settings
        self.obstacles, self.robot, self.rng, self.should_stop = obstacles, robot, rng, should_stop
        self.q_start, self.least_m, self.length_m = q_start, least_m, max(settings.approach_distance_m, least_m)
        self.rows = 1 + (max(1, int(np.ceil(self.length_m / STEP_M - 1e-9))) if self.length_m > 0.0 else 0)
        self.weight = 0.0 if settings.leaf_policy == "ignored" else settings.weight
        self.lower, self.upper = joint_window(robot, q_start)
        self.space = obstacles.space(self.lower, self.upper).handle()
        self.close_world = obstacles.with_margin(min(MODEL_ERROR_M, obstacles.world.margin))
        self.close_space = self.close_world.space(self.lower, self.upper).handle()
        self.scratch, self.state = make_scratch(obstacles.shapes, obstacles.world.fields), make_state(obstacles.shapes)
        self.memory = kernels.make_memory(robot.n)
        self.poses, self.outcomes = np.zeros((0, 4, 4)), np.zeros(0, np.int64)
        self.stretches, self.counts = np.zeros((0, self.rows, robot.n)), np.zeros(0, np.int64)
        self.estimates, self.approach = np.zeros(0), np.zeros(0, np.int64)
        self.blocked: list[Array] = []

    def hand_free(self, poses: Array) -> Bool:
        """Tell which of the poses (P, 4, 4) leave the hand free on the shortest stretch that counts, (P,)."""
        free = np.ones(len(poses), dtype=bool)
        T_tool_joint = np.linalg.inv(np.vstack([self.robot.chain.tool, [0.0, 0.0, 0.0, 1.0]]))
        for back_m in np.linspace(0.0, self.least_m, _STATIONS if self.least_m > 0.0 else 1):
            ask(self.should_stop)
            left = np.flatnonzero(free)
            frames = poses[left] @ T_tool_joint
            frames[:, :3, 3] -= back_m * poses[left, :3, 2]
            clearances = np.zeros(len(left))
            rows = np.ascontiguousarray(frames[:, :3])
            shapes, world = self.obstacles.shapes, self.close_world.world
            hand_clearances(shapes, world, self.scratch, self.state, rows, world.margin, clearances)
            free[left] = clearances >= world.margin
        return free

    def add(self, poses: Array, seeds: Array | None = None) -> None:
        """Try approaches (P, 4, 4).

        Args:
            poses: T_base_tool at the target.
            seeds: (P, n) a configuration near which each may have one; None to look for all.
        """
        first = len(self.poses)
        near = np.linalg.norm(poses[:, :3, 3], axis=1) <= self.robot.reach_m
        outcomes = np.full(len(poses), OUT_OF_REACH)
        outcomes[near] = np.where(self.hand_free(poses[near]), OUT_OF_REACH, HAND_BLOCKED)
        tried = np.flatnonzero(near & (outcomes == OUT_OF_REACH))
        targets = np.ascontiguousarray(poses[tried, :3])
        count = len(tried)
        solutions, counts = np.zeros((count, kernels.MAX_BRANCHES, self.robot.n)), np.zeros(count, np.int64)
        if seeds is not None:
            solutions[:, 0] = seeds[tried]
            kernels.solve_from(self.robot.chain, targets, solutions, counts, self.memory)
        else:
            parents = nearest_earlier(poses[tried, :3, :3], 2)
            starts = random_configurations(self.robot, _STARTS, self.rng)
            for at in range(0, count, _IN_ONE_GO):
                ask(self.should_stop)
                last = min(at + _IN_ONE_GO, count)
                chain, memory = self.robot.chain, self.memory
                kernels.solve_poses(chain, targets, at, last, parents, starts, _STARTED, solutions, counts, memory)
        nodes = np.zeros((count, kernels.MAX_BRANCHES, self.rows, self.robot.n))
        figures, codes = np.zeros((count, kernels.MAX_BRANCHES, 3)), np.full((count, kernels.MAX_BRANCHES), kernels.LIMITS)
        for at in range(0, count, _IN_ONE_GO):
            ask(self.should_stop)
            self._look(targets, at, min(at + _IN_ONE_GO, count), solutions, counts, nodes, figures, codes)
        free = (codes == kernels.FREE) | (codes == kernels.CLOSE)
        known = np.arange(kernels.MAX_BRANCHES) < counts[:, None]
        for code, outcome in ((kernels.BLOCKED, ARM_BLOCKED), (kernels.NO_ROOM, NO_ROOM), (kernels.BLOCKED_ON_THE_WAY, ARM_BLOCKED)):
            outcomes[tried[((codes == code) & known).any(axis=1)]] = outcome
        outcomes[tried[(free & known).any(axis=1)]] = FREE
        for code, row in ((kernels.BLOCKED, 0), (kernels.BLOCKED_ON_THE_WAY, None)):
            for p, b in np.argwhere((codes == code) & known)[:: max(1, count // 32)]:
                self.blocked.append(nodes[p, b, int(figures[p, b, 0]) if row is None else row].copy())
        p, b = np.nonzero(free & known)
        good = figures[p, b, 0].astype(np.int64)
        missing_m = self.length_m * (self.rows - good) / max(self.rows - 1, 1)
        estimates = figures[p, b, 1] + MISSING_COST * missing_m + np.where(codes[p, b] == kernels.CLOSE, CLOSE_COST, 0.0)
        self.poses, self.outcomes = np.concatenate([self.poses, poses]), np.concatenate([self.outcomes, outcomes])
        self.stretches, self.counts = np.concatenate([self.stretches, nodes[p, b]]), np.concatenate([self.counts, good])
        self.estimates, self.approach = np.concatenate([self.estimates, estimates]), np.concatenate([self.approach, first + tried[p]])

    def _look(
        self, targets: Array, first: int, last: int, solutions: Array, counts: Int64, nodes: Array, figures: Array, codes: Int64
    ) -> None:
        kernels.look_at(
            self.space,
            self.close_space,
            self.robot.chain,
            targets,
            first,
            last,
            solutions,
            counts,
            self.q_start,
            self.length_m,
            self.least_m,
            self.lower,
            self.upper,
            self.weight,
            self.memory,
            nodes,
            figures,
            codes,
        )

    def follow(self, target: Array, nodes: Array, figures: Array) -> int:
        """`kernels.stretch_back` for one configuration, nodes[0], with everything that this plan has for it."""
        spaces, limits = (self.space, self.close_space), (self.lower, self.upper)
        lengths = (self.length_m, self.least_m)
        code = kernels.stretch_back(*spaces, self.robot.chain, target, *lengths, *limits, nodes, self.weight, self.memory, figures)
        return int(code)

    def ranked(self) -> Int64:
        """Return all free stretches by what they and the way to them cost at least."""
        ways = np.linalg.norm(self.stretches[np.arange(len(self.counts)), self.counts - 1] - self.q_start, axis=1)
        return np.argsort(self.estimates + ways, kind="stable")

    def certified(self, wanted: int) -> Grasps:
        """Evaluate the most promising stretches along every edge until `wanted` are free that differ from each other."""
        chosen: list[int] = []
        costs: list[float] = []
        missing = self.length_m * (self.rows - self.counts) / max(self.rows - 1, 1)
        for looked, i in enumerate(self.ranked()):
            if len(chosen) == wanted or looked >= _PRICED * wanted:
                break
            if looked % _IN_ONE_GO == 0:
                ask(self.should_stop)
            count = int(self.counts[i])
            begin = self.stretches[i, count - 1]
            if any(np.abs(begin - self.stretches[j, self.counts[j] - 1]).max() < _APART_RAD for j in chosen):
                continue
            cost = kernels.price(self.space, self.stretches[i], count, self.weight, np.inf)
            if not np.isfinite(cost):
                cost = kernels.price(self.close_space, self.stretches[i], count, self.weight, np.inf) + CLOSE_COST
            if np.isfinite(cost):
                chosen.append(int(i))
                costs.append(float(cost + MISSING_COST * missing[i]))
        approaches = Approaches(self.poses, self.outcomes, np.array(self.blocked).reshape(-1, self.robot.n))
        return Grasps(self.stretches[chosen], self.counts[chosen], np.array(costs), self.approach[chosen], approaches)


def follow_back(obstacles: Obstacles, T_base_tool: Array, q_start: Array, configurations: Array) -> tuple[list[Array], Array]:
    """Follow the straight way back from configurations that hold the tool at one pose, as far as it is free.

    Args:
        obstacles: without anchors.
        T_base_tool: (4, 4) the pose.
        q_start: (n,) where the arm is [rad].
        configurations: (G, n) at the pose.

    Returns:
        Stretches, each (K, n) towards the pose with its configuration last, K at least 1; and (G,) what they cost: J, and more for
        what is missing of the wanted length.
    """
    trials = _Trials(obstacles, q_start, np.random.default_rng(0), 0.0, never)
    target = np.ascontiguousarray(T_base_tool[:3])
    stretches, costs, figures = [], [], np.zeros(3)
    for q in configurations:
        nodes = np.zeros((trials.rows, len(q)))
        nodes[0] = q
        trials.follow(target, nodes, figures)
        count, cost = max(1, int(figures[0])), np.inf
        while not np.isfinite(cost):  # ends at the pose itself, which costs nothing
            cost = kernels.price(trials.close_space, nodes, count, trials.weight, np.inf)
            count -= 0 if np.isfinite(cost) else 1
        stretches.append(np.ascontiguousarray(nodes[:count][::-1]))
        costs.append(cost + MISSING_COST * trials.length_m * (trials.rows - count) / max(trials.rows - 1, 1))
    return stretches, np.array(costs)


def joint_window(robot: Robot, q_start: Array) -> tuple[Array, Array]:
    """Limits of the joints (n,) each, within a turn of the start where there are none [rad]."""
    return np.where(robot.continuous, q_start - _TURN, robot.lower), np.where(robot.continuous, q_start + _TURN, robot.upper)


def random_configurations(robot: Robot, count: int, rng: np.random.Generator) -> Array:
    """Draw configurations (count, n) evenly between the limits, within half a turn where there are none [rad]."""
    low, high = np.where(np.isfinite(robot.lower), robot.lower, -np.pi), np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    return np.asarray(rng.uniform(low, high, (count, robot.n)))


def find_grasps(
    obstacles: Obstacles, target: Target, q_start: Array, rng: np.random.Generator, wanted: int, should_stop: Callable[[], bool] = never
) -> Grasps:
    """Look for free grasps of a target that leaves something to choose.

    Args:
        obstacles: of the target's scene, without anchors.
        target: a fruit, candidates, or a pose with freedom.
        q_start: (n,) where the arm is [rad].
        rng: source of chance; the same one gives the same grasps.
        wanted: how many at most.
        should_stop: cancels.

    Raises:
        Refusal: CANCELLED.
    """
    settings = obstacles.settings
    least_m = min(settings.min_approach_distance_m, settings.approach_distance_m)
    trials = _Trials(obstacles, q_start, rng, least_m if target.kind != "pose" else 0.0, should_stop)
    if target.kind == "candidates":
        order = rng.permutation(len(target.poses))
        trials.add(target.poses[order])
        return trials.certified(wanted)
    if target.kind == "fruit":
        away = float(np.linalg.norm(target.centre))
        axis = target.centre / away if away > 1e-9 else np.array([0.0, 0.0, 1.0])
    else:
        axis = target.poses[0, :3, 2]
    first = max(1, int(_FIRST_SHARE * settings.max_grasps))
    points = spread(first, rng)
    if target.freedom == "roll":
        points[:, :2] = 0.0
    cone_rad = 0.0 if target.freedom == "roll" else settings.approach_cone_rad
    trials.add(_placed(in_cone(axis, cone_rad, points), target.centre))
    parents = _PARENTS
    for round_ in range(_ROUNDS):
        order = trials.ranked()[:parents]
        if not len(order) or (target.freedom == "roll" and round_):
            break
        share = (settings.max_grasps - first) // _ROUNDS
        chosen = np.resize(order, share)
        if not share:
            break
        turns = around(trials.poses[trials.approach[chosen], :3, :3], axis, cone_rad, _TURN_RAD / 2.0**round_, rng)
        trials.add(_placed(turns, target.centre), trials.stretches[chosen, 0])
        parents = max(1, parents // 2)
    return trials.certified(wanted)


def _placed(rotations: Array, centre: Array) -> Array:
    """Put rotations (P, 3, 3) at a place (3,): poses (P, 4, 4)."""
    poses = np.tile(np.eye(4), (len(rotations), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = centre
    return poses
