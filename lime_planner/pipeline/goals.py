"""Where the arm starts and where it may end: checked configurations for the search."""

from __future__ import annotations

import collections
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from lime_planner.collision.exact import ExactChecker, Hit
from lime_planner.collision.fast import LEAF, SELF
from lime_planner.collision.joint_space import ArmSpace
from lime_planner.collision.joint_space import measure as arm_measure
from lime_planner.collision.self_contact import SELF_CLEARANCE_M
from lime_planner.core.status import Status
from lime_planner.core.types import Array, Int64
from lime_planner.motion.contract import POSITION_TOLERANCE_RAD
from lime_planner.pipeline.obstacles import Obstacles
from lime_planner.robot.ik import solve_ik

MODEL_ERROR_M = 0.001  # a goal's clearance in the fast model must exceed what the model may be wrong by
TOO_CLOSE = f"within {1e3 * MODEL_ERROR_M:g} mm of something hard, too close to be certified"
_BELOW_OWN_M = 0.0004  # at an anchor a little less than its own clearance is required
_OVERHANG_M = 0.008  # the fast model's spheres reach this far beyond the meshes where they meet boxes, floor and workspace
_BOX_SLACK_RAD = np.pi / 2  # the sampling box reaches this far beyond start and goals


@dataclass(frozen=True, eq=False)
class Approaches:
    """What became of the approaches that were tried.

    Attributes:
        poses: (A, 4, 4) T_base_tool at the target.
        outcomes: (A,) OUT_OF_REACH, HAND_BLOCKED, ARM_BLOCKED, NO_ROOM, FREE or DEARER. The last is reached, but would cost more than
            enough free ones whatever stands around it: whether it is free was not looked at.
        blocked: up to a few hundred configurations (K, n) that were refused because the arm touches something hard.
    """

    poses: Array
    outcomes: Int64
    blocked: Array


OUT_OF_REACH, HAND_BLOCKED, ARM_BLOCKED, NO_ROOM, FREE, DEARER = 0, 1, 2, 3, 4, 5  #: what became of an approach
OUTCOMES = ("out_of_reach", "hand_blocked", "arm_blocked", "no_room", "free", "dearer")  #: the same as words, by number


@dataclass(frozen=True)
class Goals:
    """Goal configurations, or why there are none.

    Attributes:
        configurations: (G, n) unwrapped near the start, most promising first.
        anchors: (A, n) start and goals with less clearance than the margin, needs: (A,) what to require there [m].
        status, sentence: NO_IK_SOLUTION or GOAL_IN_STEM with the reason; None if there are goals.
        found: how many solutions inverse kinematics gave, or free grasps were chosen.
        costs: (G,) terminal costs: what comes behind each configuration adds to J.
        stretches: for each configuration the way from there to the grasp, (K, n) with the configuration first; K is 1 at the grasp itself.
        poses: (G, 4, 4) T_base_tool at the grasps.
        tried, free: numbers of approaches.
        approaches: what became of them, None where there was nothing to choose.
        more: makes these goals and dearer ones, for a search that finds no way to these; None where there are no more.
    """

    configurations: Array
    anchors: Array
    needs: Array
    status: Status | None
    sentence: str
    found: int
    costs: Array = field(default_factory=lambda: np.zeros(0))
    stretches: tuple[Array, ...] = ()
    poses: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    tried: int = 0
    free: int = 0
    approaches: Approaches | None = None
    more: Callable[[], Goals] | None = None

    def behind(self, q: Array) -> tuple[int, Array]:
        """Return which goal is at a path's end q (n,), and the way from there to its grasp, (K, n)."""
        which = int(np.linalg.norm(self.configurations - q, axis=1).argmin())
        return which, self.stretches[which]

    def without(self, which: int) -> Goals:
        """The same but for one goal."""
        kept = np.delete(np.arange(len(self.configurations)), which)
        stretches = tuple(self.stretches[i] for i in kept)
        return replace(self, configurations=self.configurations[kept], costs=self.costs[kept], stretches=stretches, poses=self.poses[kept])


def measure(space: ArmSpace, q: Array) -> tuple[float, float, float]:
    """Clearance to everything hard, to the arm itself, and leaf intensity at q, whatever is required there."""
    arm_measure(space, q)
    return float(space.state.clear.min()), float(space.state.misc[SELF]), float(space.state.misc[LEAF])


def examine_start(obstacles: Obstacles, checker: ExactChecker, q_start: Array) -> tuple[Status, str] | None:
    """Return the reason why the arm cannot start where it stands, or None.

    A start inside the stem margin is no reason; a start that touches a stem by its exact meshes is. A start a little beyond a joint
    limit (`start_limit_tolerance_rad`) is led back inside.
    """
    tolerance_rad = obstacles.settings.start_limit_tolerance_rad + POSITION_TOLERANCE_RAD
    sentence = obstacles.robot.limit_violation(q_start, tolerance_rad=tolerance_rad)
    if sentence is not None:
        return Status.START_INVALID, sentence
    hit = checker.stem_hit(q_start)
    if hit is None:
        return None
    status = Status.START_IN_STEM if hit.what == "stem" else Status.START_INVALID
    spot = obstacles.spot
    if spot is not None and hit.place is not None and spot.is_fruit(hit.place):
        return status, "where the arm stands, {} touches the fruit itself, whose centre is {:.3f} {:.3f} {:.3f}".format(
            hit.link, *spot.centre
        )
    return status, f"where the arm stands, {hit}"


def find_goals(obstacles: Obstacles, checker: ExactChecker, T_base_tool: Array, q_start: Array, rng: np.random.Generator) -> Goals:
    """Solve inverse kinematics and sort the solutions into goals."""
    n = obstacles.robot.n
    ik = solve_ik(obstacles.robot, T_base_tool, q_start, rng, starts=obstacles.settings.ik_starts)
    if len(ik.solutions) == 0:
        return Goals(np.zeros((0, n)), np.zeros((0, n)), np.zeros(0), Status.NO_IK_SOLUTION, ik.detail, 0)
    return sort_out(obstacles, checker, ik.solutions, q_start)


def sort_out(obstacles: Obstacles, checker: ExactChecker, solutions: Array, q_start: Array) -> Goals:
    """Sort solutions of inverse kinematics (S, n), S at least 1, into goals.

    The fast model decides: it is right to `MODEL_ERROR_M`, so nothing that clears the stems by a little more is lost. The exact check
    says what blocks the others.
    """
    settings = obstacles.settings
    n = obstacles.robot.n
    none = np.zeros((0, n))
    space = obstacles.measuring_space()
    kept: list[tuple[float, Array, float]] = []
    hits: dict[str, list[Hit]] = {}
    widest = 0.0  # clearance of those that touch nothing and are too close all the same
    for q in solutions:
        clear, own, leaf = measure(space, q)
        if clear < MODEL_ERROR_M or own < SELF_CLEARANCE_M:
            hit = checker.stem_hit(q)
            what = hit.what if hit is not None else "tight"
            widest = widest if hit is not None else max(widest, min(clear, own))
            hits.setdefault(what, []).append(hit or _TIGHT)
            continue
        rank = float(np.linalg.norm(q - q_start)) + (1.0 if leaf > 0.0 else 0.0)
        kept.append((rank, q, clear))
    if not kept:
        words = _IN_WORDS if settings.leaf_policy != "solid" else _IN_WORDS | {"stem": "in a stem or a leaf (leaves are solid)"}
        parts = ", ".join(f"{len(met)} {words[what]}{_where(met)}" for what, met in sorted(hits.items()))
        parts += f" ({1e3 * widest:.1f} mm at most)" if "tight" in hits else ""
        sentence = f"all {len(solutions)} configurations that reach the target are blocked: {parts}"
        return Goals(none, none, np.zeros(0), Status.GOAL_IN_STEM, sentence, len(solutions))
    kept.sort(key=lambda item: item[0])
    chosen = np.array([q for _, q, _ in kept[: settings.max_goals]])
    anchors, needs = tight_anchors(obstacles, chosen, q_start)
    poses = np.array([obstacles.robot.forward(q) for q in chosen])
    stretches = tuple(q[None] for q in chosen)
    return Goals(chosen, anchors, needs, None, "", len(solutions), np.zeros(len(chosen)), stretches, poses)


def tight_anchors(obstacles: Obstacles, goals: Array, q_start: Array) -> tuple[Array, Array]:
    """Return the goals (G, n), and the start (n,), that have less clearance than the margin, (A, n), and what to require there, (A,)."""
    space, margin = obstacles.measuring_space(), obstacles.world.margin
    tight = []
    for q in goals:
        clear = measure(space, q)[0]
        if clear < margin + _BELOW_OWN_M:
            tight.append((q, max(MODEL_ERROR_M - _BELOW_OWN_M, clear - _BELOW_OWN_M)))
    start_clear = measure(space, q_start)[0]
    if start_clear < margin + _BELOW_OWN_M:
        tight.append((q_start, max(-_OVERHANG_M, start_clear - _BELOW_OWN_M)))  # the exact check has let it pass
    return np.array([q for q, _ in tight]).reshape(-1, len(q_start)), np.array([need for _, need in tight])


def _where(hits: list[Hit]) -> str:
    """Say which link most of some contacts are of, and the place of one in their midst."""
    link, count = collections.Counter(hit.link for hit in hits).most_common(1)[0]
    if not link:
        return ""
    own = [hit for hit in hits if hit.link == link]
    often = "" if count == len(hits) else "most often "
    if own[0].what == "self":
        return f" ({often}{link} and {collections.Counter(hit.other for hit in own).most_common(1)[0][0]})"
    places = np.array([hit.place for hit in own if hit.place is not None])
    if not len(places):
        return f" ({often}{link})"
    nearest = places[np.linalg.norm(places - np.median(places, axis=0), axis=1).argmin()]
    return " ({}{} at {:.2f} {:.2f} {:.2f})".format(often, link, *nearest)


_TIGHT = Hit("", "stem", "")
_IN_WORDS = {
    "stem": "in a stem",
    "tight": TOO_CLOSE,
    "self": "in collision with the arm itself",
    "keep_out": "in a keep-out box",
    "floor": "below the floor",
    "workspace": "outside the workspace box",
}


def sampling_box(obstacles: Obstacles, q_start: Array, goals: Array) -> tuple[Array, Array]:
    """Bounds for samples: around start and goals, within the limits and ±2π of the start."""
    robot = obstacles.robot
    everything = np.vstack([q_start[None], goals])
    window = 2.0 * np.pi
    lower = np.maximum(everything.min(axis=0) - _BOX_SLACK_RAD, np.where(robot.continuous, q_start - window, robot.lower))
    upper = np.minimum(everything.max(axis=0) + _BOX_SLACK_RAD, np.where(robot.continuous, q_start + window, robot.upper))
    return np.minimum(lower, everything.min(axis=0)), np.maximum(upper, everything.max(axis=0))
