"""From a target to pre-grasp configurations: which approaches are free, and what their straight stretches cost.

An approach is a pose of the tool at the target. Cheap refusals come first: the hand alone against everything hard needs no
configuration and settles most. Inverse kinematics goes on from the configurations of approaches nearby, the straight stretch is followed
backwards from each solution, and where stretches are cheap more approaches are tried (successive halving). The search then gets the
configurations where stretches begin as its goals, and what the stretches cost as the goals' terminal costs.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from lime_planner.collision.fast import make_scratch, make_state
from lime_planner.collision.hand import hand_clearances
from lime_planner.collision.touched_points import touched_anywhere
from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array, Bool, Int32, Int64
from lime_planner.pipeline.context import ask, never
from lime_planner.pipeline.goals import ARM_BLOCKED, DEARER, FREE, HAND_BLOCKED, MODEL_ERROR_M, NO_ROOM, OUT_OF_REACH, Approaches
from lime_planner.pipeline.grasps import kernels
from lime_planner.pipeline.grasps.approaches import around, in_cone, nearest_earlier, spread
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.pipeline.targets import Target
from lime_planner.robot.model import Robot
from lime_planner.scene.voxels import thin

STEP_M = 0.01  # of a stretch
MISSING_COST = 1e4  # per metre that a stretch is shorter than wanted [rad/m]

_DEEPEST_M = 0.05  # blocked hands that reach deeper into something hard than this are all the same
_STATIONS = 4  # places of the hand on the shortest stretch that counts
# Shares of the approaches: those that are spread evenly, then rounds of such that fall near the cheapest. The last ones are for fruit at
# which even the cheapest touches leaves.
_SHARES, _FREE_SHARES = (0.36, 0.12, 0.12, 0.2, 0.2), 3
_PARENTS = 24  # cheapest configurations around which more are tried in the first of these rounds; then half as many
_AROUND_BLOCKED = ((48, 0.2), (24, 0.15), (12, 0.1), (12, 0.1))  # while nothing is free: around so many, so far from them [rad]
_TURN_RAD = 0.25  # how far from them, in the first round; then half as far
# The leaf area that the arm lies in at the grasp costs as much as so much leaf contact: touching one leaf for longer is better than five
# at once, which J alone takes for alike.
_AREA_RAD_PER_M2 = 30.0
_AREA_CELL_M = 0.01  # a cell of this edge in which a leaf point is touched counts as its square
_WEIGHED = 4  # times as many of the cheapest stretches as are wanted, of which the area is asked and which are certified; no other counts
_STARTED, _STARTS = 4, 48  # approaches, and random starts for each, with which inverse kinematics begins
_IN_ONE_GO = 24  # approaches, or configurations, between two looks at whether to stop
_APART_RAD = 0.2  # between two goals
_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Grasps:
    """Free grasps, cheapest first.

    Attributes:
        stretches: (G, K + 1, n) configurations from the grasp backwards; the first `counts` of each count [rad].
        counts: (G,) at least 1.
        costs: (G,) J of the stretch with what is added for what it lacks, and for the leaf area touched at the grasp.
        approach: (G,) which approach each belongs to.
        approaches: all that were tried.
        more: makes these and dearer ones, further apart: the cheapest may all lie where no way leads. None where there are no more.
    """

    stretches: Array
    counts: Int64
    costs: Array
    approach: Int64
    approaches: Approaches
    more: Callable[[], Grasps] | None = None


class Trials:
    """The approaches of one plan: solved, looked at, priced."""

    @classmethod
    def for_target(
        cls, obstacles: Obstacles, target: Target, q_start: Array, rng: np.random.Generator, should_stop: Callable[[], bool]
    ) -> Trials:
        """Make room for trials of a target that leaves something to choose; see `find_grasps`."""
        return cls(obstacles, q_start, rng, least_stretch_m(target, obstacles.settings), should_stop)

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
        self.totals, self.approach = np.zeros(0), np.zeros(0, np.int64)  # costs of stretches and of the shortest ways to them
        self.cheapest = np.zeros(0)  # totals of the stretches that can still count; empty: all of them can, however dear
        self.area_costs = np.zeros(0)  # NaN where the area has not been asked for
        apart = self.weight > 0.0 and settings.leaf_policy == "permeable" and settings.leaf_cost == "binary"
        self.area_price = self.weight * _AREA_RAD_PER_M2 if apart else 0.0
        self.leaf_cells: Int32 | None = None  # in which cell each leaf point is, once that is asked for
        self.blocked: list[Array] = []

    def leave_dearer(self, wanted: int) -> None:
        """From now on leave stretches that can no longer be among those that `ranked` looks at for `wanted`."""
        self.cheapest = np.full(_WEIGHED * wanted, np.inf)

    def hand_free(self, poses: Array) -> Bool:
        """Tell which of the poses (P, 4, 4) leave the hand free on the shortest stretch that counts, (P,)."""
        need = self.close_world.world.margin
        free = np.ones(len(poses), dtype=bool)
        for back_m in stations(self.least_m):
            left = np.flatnonzero(free)
            free[left] = self._hand_clearances(poses[left], back_m, need) >= need
        return free

    def least_blocked(self, count: int) -> Int64:
        """Return which refused approaches to look around, the most promising first: those free for the hand, then by its clearance."""
        refused = np.flatnonzero((self.outcomes == HAND_BLOCKED) | (self.outcomes == ARM_BLOCKED) | (self.outcomes == NO_ROOM))
        poses, clearance = self.poses[refused], np.zeros(len(refused))
        blocked = np.flatnonzero(self.outcomes[refused] == HAND_BLOCKED)
        for back_m in stations(self.least_m):
            clearance[blocked] = np.minimum(clearance[blocked], self._hand_clearances(poses[blocked], back_m, -_DEEPEST_M))
        return refused[np.argsort(-clearance, kind="stable")[:count]]

    def _hand_clearances(self, poses: Array, back_m: float, need_m: float) -> Array:
        """Return the hand's clearances at poses (P, 4, 4), drawn back by so much, (P,): exact near `need_m`, below it anything [m]."""
        ask(self.should_stop)
        frames = poses @ np.linalg.inv(np.vstack([self.robot.chain.tool, [0.0, 0.0, 0.0, 1.0]]))
        frames[:, :3, 3] -= back_m * poses[:, :3, 2]
        clearances = np.zeros(len(poses))
        rows = np.ascontiguousarray(frames[:, :3])
        hand_clearances(self.obstacles.shapes, self.close_world.world, self.scratch, self.state, rows, need_m, clearances)
        return clearances

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
        totals = np.full((count, kernels.MAX_BRANCHES), np.inf)
        self._look(targets, solutions, counts, nodes, figures, codes, totals)
        free = (codes == kernels.FREE) | (codes == kernels.CLOSE)
        for code, outcome in (
            (kernels.BLOCKED, ARM_BLOCKED),
            (kernels.NO_ROOM, NO_ROOM),
            (kernels.BLOCKED_ON_THE_WAY, ARM_BLOCKED),
            (kernels.DEARER, DEARER),
        ):
            outcomes[tried[(codes == code).any(axis=1)]] = outcome
        outcomes[tried[free.any(axis=1)]] = FREE
        for code, row in ((kernels.BLOCKED, 0), (kernels.BLOCKED_ON_THE_WAY, None)):
            for p, b in np.argwhere(codes == code)[:: max(1, count // 32)]:
                self.blocked.append(nodes[p, b, int(figures[p, b, 0]) if row is None else row].copy())
        p, b = np.nonzero(free)
        self.poses, self.outcomes = np.concatenate([self.poses, poses]), np.concatenate([self.outcomes, outcomes])
        self.stretches = np.concatenate([self.stretches, nodes[p, b]])
        self.counts = np.concatenate([self.counts, figures[p, b, 0].astype(np.int64)])
        self.totals = np.concatenate([self.totals, totals[p, b]])
        self.approach = np.concatenate([self.approach, first + tried[p]])
        known_area = (figures[p, b, 2] <= 0.0) | (self.area_price <= 0.0)
        self.area_costs = np.concatenate([self.area_costs, np.where(known_area, 0.0, np.nan)])

    def _look(self, targets: Array, solutions: Array, counts: Int64, nodes: Array, figures: Array, codes: Int64, totals: Array) -> None:
        """Look at configurations, those near the start first: then the bound that spares the others is low soon."""
        ways = np.full(codes.shape, np.inf)
        kernels.begin(solutions, counts, self.q_start, self.lower, self.upper, nodes, ways)
        order = np.argsort(ways, axis=None, kind="stable")[: np.isfinite(ways).sum()]
        rows = np.column_stack(np.unravel_index(order, ways.shape))
        lengths, limits = (self.length_m, self.least_m, self.missing_cost(self.rows - 1)), (self.lower, self.upper)
        for at in range(0, len(rows), _IN_ONE_GO):
            ask(self.should_stop)
            some = rows[at : at + _IN_ONE_GO]
            kernels.look_at(
                *(self.space, self.close_space, self.robot.chain, targets, some, self.q_start, *lengths, *limits, self.weight, self.memory),
                *(nodes, figures, codes, totals, self.cheapest),
            )

    def follow(self, target: Array, nodes: Array, figures: Array) -> int:
        """`kernels.stretch_back` for one configuration, nodes[0], with everything that this plan has for it."""
        spaces, limits = (self.space, self.close_space), (self.lower, self.upper)
        lengths = (self.length_m, self.least_m)
        bounds = (self.q_start, np.inf)
        code = kernels.stretch_back(*spaces, self.robot.chain, target, *lengths, *limits, nodes, self.weight, *bounds, self.memory, figures)
        return int(code)

    def missing_cost(self, count: int) -> float:
        """What is added for a stretch of `count` nodes that is shorter than wanted [rad]."""
        return MISSING_COST * self.length_m * (self.rows - count) / max(self.rows - 1, 1)

    def neighbour(self, pose: Array, q: Array, count: int, most_rad: float, bound: float) -> tuple[Array, float] | None:
        """Take a grasp next to one whose configuration is known.

        Args:
            pose: (4, 4) T_base_tool of the grasp.
            q: (n,) configuration at a grasp near it.
            count: nodes that its stretch must have at least.
            most_rad: how far a joint may be from q.
            bound: what it may cost.

        Returns:
            The stretch (K, n), the grasp last, certified along every edge, and its price; None where it is not free, too short, in
            another branch, or not cheaper than `bound`.
        """
        target = np.ascontiguousarray(pose[:3])
        solutions, counts = np.zeros((1, kernels.MAX_BRANCHES, len(q))), np.zeros(1, np.int64)
        solutions[0, 0] = q
        kernels.solve_from(self.robot.chain, target[None], solutions, counts, self.memory)
        if not counts[0] or np.abs(solutions[0, 0] - q).max() > most_rad:
            return None
        nodes, figures = np.zeros((self.rows, len(q))), np.zeros(3)
        nodes[0] = solutions[0, 0]
        code = self.follow(target, nodes, figures)
        good = int(figures[0])
        if code not in (kernels.FREE, kernels.CLOSE) or good < count:
            return None
        added = self.missing_cost(good)
        if figures[2] > 0.0 and self.area_price > 0.0:
            added += self.area_price * self._touched_m2(nodes[0])
        space = self.space
        if code == kernels.CLOSE:
            space, added = self.close_space, added + kernels.CLOSE_COST
        cost = kernels.price(space, nodes, good, self.weight, bound - added) + added
        if not cost < bound:
            return None
        return np.ascontiguousarray(nodes[:good][::-1]), float(cost)

    def ranked(self, wanted: int) -> Iterator[int]:
        """Yield free stretches by what they, the shortest way to them and the leaf area at the grasp cost, cheapest first.

        Of so many as can count for `wanted`; the area is counted of those only that may be next.
        """
        ask(self.should_stop)
        first = np.argsort(self.totals, kind="stable")[: _WEIGHED * wanted]
        known = (self.totals + np.nan_to_num(self.area_costs))[first]
        heap = list(zip(known, range(len(first)), strict=True))
        heapq.heapify(heap)
        while heap:
            cost, place = heapq.heappop(heap)
            i = first[place]
            if np.isnan(self.area_costs[i]):
                self.area_costs[i] = self.area_price * self._touched_m2(self.stretches[i, 0])
                heapq.heappush(heap, (cost + self.area_costs[i], place))
            else:
                yield int(i)

    def _beyond(self, wanted: int) -> Iterator[int]:
        """Yield the free stretches that `ranked` leaves out, cheapest first: the cheapest may all lie where no way leads."""
        yield from np.argsort(self.totals, kind="stable")[_WEIGHED * wanted :].tolist()

    def _touched_m2(self, q: Array) -> float:
        """Leaf area (one side) that the arm lies in at q (n,), by the cells that hold touched points [m²]."""
        table = self.obstacles.world.fields.leaves
        touched = touched_anywhere(self.robot, self.obstacles.shapes, q, table, self.obstacles.world.leaf_radius)
        if self.leaf_cells is None:
            self.leaf_cells = thin(table.points, _AREA_CELL_M)[1]
        return len(np.unique(self.leaf_cells[touched])) * _AREA_CELL_M**2

    def touches_leaves(self) -> bool:
        """Tell whether even the cheapest stretch costs leaf contact."""
        best = next(self.ranked(1), None)
        if best is None:
            return False
        way = np.vstack([self.stretches[best, : self.counts[best]], self.q_start])
        return bool(self.totals[best] > np.linalg.norm(np.diff(way, axis=0), axis=1).sum() + kernels.CLOSE_COST + 1e-6)

    def certified(self, wanted: int, *, beyond: bool = False) -> Grasps:
        """Evaluate the most promising stretches along every edge until `wanted` are free that differ from each other.

        Args:
            wanted: how many at most.
            beyond: go on with dearer ones than `ranked` has, until there are so many.
        """
        chosen: list[int] = []
        costs: list[float] = []
        rows = itertools.chain(self.ranked(wanted), self._beyond(wanted)) if beyond else self.ranked(wanted)
        for looked, i in enumerate(rows):
            if len(chosen) == wanted:
                break
            if looked % _IN_ONE_GO == 0:
                ask(self.should_stop)
            count = int(self.counts[i])
            begin = self.stretches[i, count - 1]
            if any(np.abs(begin - self.stretches[j, self.counts[j] - 1]).max() < _APART_RAD for j in chosen):
                continue
            cost = kernels.price(self.space, self.stretches[i], count, self.weight, np.inf)
            if not np.isfinite(cost):
                cost = kernels.price(self.close_space, self.stretches[i], count, self.weight, np.inf) + kernels.CLOSE_COST
            if np.isfinite(cost):
                chosen.append(int(i))
                costs.append(float(cost + self.missing_cost(count) + np.nan_to_num(self.area_costs[i])))
        approaches = Approaches(self.poses, self.outcomes, np.array(self.blocked).reshape(-1, self.robot.n))
        left = not beyond and len(chosen) < wanted and len(self.totals) > _WEIGHED * wanted
        more = partial(self.certified, wanted, beyond=True) if left else None
        return Grasps(self.stretches[chosen], self.counts[chosen], np.array(costs), self.approach[chosen], approaches, more)


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
    trials = Trials(obstacles, q_start, np.random.default_rng(0), 0.0, never)
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
        costs.append(cost + trials.missing_cost(count))
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
    trials = Trials.for_target(obstacles, target, q_start, rng, should_stop)
    if target.kind == "candidates":  # each is looked at to the end: whoever names approaches wants to know which are free
        order = rng.permutation(len(target.poses))
        trials.add(target.poses[order])
        return trials.certified(wanted)
    trials.leave_dearer(max(wanted, _PARENTS))
    axis, cone_rad = cone_of(target, settings)
    points = spread(max(1, int(_SHARES[0] * settings.max_grasps)), rng)
    if target.freedom == "roll":
        points[:, :2] = 0.0
    trials.add(_placed(in_cone(axis, cone_rad, points), target.centre))
    parents = _PARENTS
    for number, share in enumerate(_SHARES[1:], start=1):
        free, count = len(trials.totals) > 0, int(share * settings.max_grasps)
        if not count or (free and number >= _FREE_SHARES and not trials.touches_leaves()):
            break
        if free:
            chosen = np.resize(list(itertools.islice(trials.ranked(parents), parents)), count)
            turns = around(trials.poses[trials.approach[chosen], :3, :3], axis, cone_rad, _TURN_RAD / 2.0 ** (number - 1), rng)
            trials.add(_placed(turns, target.centre), trials.stretches[chosen, 0])
            parents = max(1, parents // 2)
            continue
        # Nothing is free yet: look around what lacks least, the hand first.
        around_few, turn_rad = _AROUND_BLOCKED[number - 1]
        blocked = trials.least_blocked(around_few)
        if not len(blocked):
            break
        turns = around(trials.poses[np.resize(blocked, count), :3, :3], axis, cone_rad, turn_rad, rng)
        trials.add(_placed(turns, target.centre))
    return trials.certified(wanted)


def least_stretch_m(target: Target, settings: Settings) -> float:
    """Return how long the straight stretch to a target must be at least [m]: a pose takes what there is."""
    return 0.0 if target.kind == "pose" else min(settings.min_approach_distance_m, settings.approach_distance_m)


def stations(least_m: float) -> Array:
    """Return how far back along the shortest stretch that counts the hand is looked at [m]."""
    return np.linspace(0.0, least_m, _STATIONS if least_m > 0.0 else 1)


def cone_of(target: Target, settings: Settings) -> tuple[Array, float]:
    """Return the cone of directions from which a fruit or a pose with freedom may be approached: its axis (3,) and half its angle [rad]."""
    cone_rad = 0.0 if target.freedom == "roll" else settings.approach_cone_rad
    if target.kind != "fruit":
        return target.poses[0, :3, 2], cone_rad
    away = float(np.linalg.norm(target.centre))
    return (target.centre / away if away > 1e-9 else np.array([0.0, 0.0, 1.0])), cone_rad


def _placed(rotations: Array, centre: Array) -> Array:
    """Put rotations (P, 3, 3) at a place (3,): poses (P, 4, 4)."""
    poses = np.tile(np.eye(4), (len(rotations), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = centre
    return poses
