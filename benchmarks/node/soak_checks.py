"""What the soak test holds every motion command to, by means of its own: the published scene, the recorded joint states, the exact meshes.

Nothing here asks the planner; a command is judged from what was on the wire and from the scene file or seed alone.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from lime_planner.collision.arm_filter import ArmSurface
from lime_planner.collision.exact import ExactChecker
from lime_planner.core.geometry import whole_turns
from lime_planner.motion.contract import violations
from lime_planner.motion.trajectory import Trajectory
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene

STEP_RAD = 0.01
STEM_RADIUS_M = 0.004
EXCLUSION_M, APPROACH_M, PADDING_M = 0.06, 0.10, 0.01  # the planner's defaults
START_TOLERANCE_RAD = 0.012  # the contract's 0.01, and what one joint state may move on the way to us
LIMIT_TOLERANCE_RAD = 0.03  # an arm that rests so far beyond a limit is led back
STAMP_S = 0.4  # how well the moment of a cloud's stamp is known here
ON_THE_WAY_S = 0.05  # a command that left before a stop may come after its answer
STOP_REACH_RAD = 0.15  # a stop ends at most this far from the newest joint state, or from the path
_REMEMBERED_S = 60.0


def trajectory_of(msg: JointTrajectory) -> Trajectory:
    """A command as arrays."""
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in msg.points]
    positions, velocities = (np.array([list(getattr(point, what)) for point in msg.points]) for what in ("positions", "velocities"))
    trajectory = Trajectory.from_samples(tuple(msg.joint_names), times, positions, velocities)
    return dataclasses.replace(trajectory, dt_s=round(trajectory.dt_s, 9))  # times are whole nanoseconds


@dataclass(frozen=True)
class World:
    """A scene as it was published, and where the arm was then (points on it are no obstacle for the planner).

    Attributes:
        scene: the scene.
        left_out: place (3,) whose fruit was left out of the stem cloud, or None for a labelled cloud, which tells fruit apart.
        since_s: when it was published; the cloud's stamp is within some tenths of a second of it.
    """

    scene: Scene
    left_out: np.ndarray | None
    since_s: float

    def hard_points(self, target: np.ndarray | None) -> np.ndarray:
        """What an arm on its way to a target must not touch, (N, 3)."""
        spared = target if self.left_out is None else self.left_out
        return self.scene.impermeable_points(spared, EXCLUSION_M).astype(np.float64)


@dataclass
class Judge:
    """Judges commands one after the other.

    Attributes:
        robot: the arm.
        faults: a sentence for every command that must not have been sent.
        motions, stops: how many of each were judged.
    """

    robot: Robot
    faults: list[str] = field(default_factory=list)
    motions: int = 0
    stops: int = 0

    def __post_init__(self) -> None:
        self._surface = ArmSurface(self.robot)
        self._states: deque[tuple[float, np.ndarray, np.ndarray]] = deque()  # when, (n,) without jumps of whole turns, (n,) as reported
        self.world: World | None = None
        self._running: tuple[float, Trajectory, np.ndarray | None] | None = None
        self._checker: tuple[World, tuple[float, ...], ExactChecker] | None = None
        self._quiet: deque[tuple[float, float]] = deque(maxlen=4)  # from a stop's answer to the next request nothing may move
        self._stopped_s = np.inf

    def state(self, q: np.ndarray) -> None:
        """Take note of a joint state."""
        now_s = time.monotonic()
        before = self._states[-1][1] if self._states else q
        # A driver may report joints that turn without end within one turn: the arm has not jumped then.
        self._states.append((now_s, q - whole_turns(q - before, self.robot.continuous), q))
        while self._states[0][0] < now_s - _REMEMBERED_S:
            self._states.popleft()

    def asked(self, kind: str) -> None:
        """Take note of a request."""
        if kind != "stop" and self._stopped_s < np.inf:
            self._quiet.append((self._stopped_s, time.monotonic()))
            self._stopped_s = np.inf

    def answered(self, kind: str) -> None:
        """Take note of an answer."""
        if kind == "stop":
            self._stopped_s = min(self._stopped_s, time.monotonic())

    def newest(self, before_s: float = np.inf) -> np.ndarray | None:
        """The newest joint state before a moment."""
        return next((q for at_s, q, _ in reversed(list(self._states)) if at_s <= before_s), None)

    def nearest(self, before_s: float, start: np.ndarray) -> np.ndarray | None:
        """The newest joint state before a moment, without jumps or as it was reported, whichever is nearer to a command's start."""
        for at_s, q, reported in reversed(list(self._states)):
            if at_s <= before_s:
                return min((q, reported), key=lambda place: float(np.abs(place - start).max()))
        return None

    def publish(self, scene: Scene, left_out: np.ndarray | None) -> None:
        """Take note of a scene that is published now."""
        self.world = World(scene, left_out, time.monotonic())

    def knows(self, msg: JointTrajectory, statuses: list[dict[str, str]]) -> bool:
        """Tell whether there is a status for a command; a stop needs none."""
        first = msg.points[0].time_from_start if msg.points else None
        return first is None or first.sec + first.nanosec > 0 or target_of(trajectory_of(msg), statuses)[0]

    def command(self, at_s: float, msg: JointTrajectory, statuses: list[dict[str, str]]) -> None:
        """Judge a command.

        Args:
            at_s: when it came.
            msg: the command.
            statuses: what the planner said lately; only the target of the plan is read from it.
        """
        try:
            trajectory = trajectory_of(msg)
        except Exception as error:
            self.faults.append(f"a command cannot be read: {error}")
            return
        stop = trajectory.first_time_s > 0.0
        found = self._stop(at_s, trajectory) if stop else self._motion(at_s, trajectory, statuses)
        if (msg.header.stamp.sec, msg.header.stamp.nanosec) != (0, 0):
            found.append("its stamp is not zero")
        if any(point.accelerations or point.effort for point in msg.points):
            found.append("it has accelerations or efforts")
        kind = "stop" if stop else f"motion ({kind_of(trajectory, statuses)})"
        self.faults += [f"{kind} of {trajectory.duration_s:.2f} s: {sentence}" for sentence in found]
        self.stops += stop
        self.motions += not stop

    def _stop(self, at_s: float, trajectory: Trajectory) -> list[str]:
        running, self._running = self._running, None
        found = []
        q = self.nearest(at_s, trajectory.positions[-1])
        if not (np.isfinite(trajectory.positions).all() and np.isfinite(trajectory.velocities).all()):
            found.append("a number is not finite")
        if trajectory.velocities[-1].any():
            found.append("the last velocity is not zero")
        if trajectory.joint_names != self.robot.joint_names:
            found.append(f"joints {trajectory.joint_names}")
        places = [] if q is None else [q[None]]
        if running is not None:  # silent joint states tell nothing of where it is; the plan does
            places.append(running[1].positions)
        off = min((float(np.abs(rows - trajectory.positions[-1]).max(axis=1).min()) for rows in places), default=0.0)
        if off > STOP_REACH_RAD:
            found.append(f"it ends {off:.2f} rad from where the arm is and from its path")
        return found

    def _motion(self, at_s: float, trajectory: Trajectory, statuses: list[dict[str, str]]) -> list[str]:
        robot, q = self.robot, self.nearest(at_s, trajectory.positions[0])
        if q is None:
            return ["sent without a joint state"]
        turn = 2.0 * np.pi + 1e-6
        found = violations(
            trajectory,
            q_measured=q,
            lower=np.where(robot.continuous, q - turn - START_TOLERANCE_RAD, robot.lower),
            upper=np.where(robot.continuous, q + turn + START_TOLERANCE_RAD, robot.upper),
            velocity_limits=robot.velocity_limits,
            acceleration_limits=robot.acceleration_limits,
            joint_names=robot.joint_names,
            start_tolerance_rad=START_TOLERANCE_RAD,
            limit_tolerance_rad=LIMIT_TOLERANCE_RAD,
        )
        if self._running is not None and at_s < self._running[0] + self._running[1].duration_s - 0.05:
            found.append("it was sent while another motion ran")
        if any(since_s + ON_THE_WAY_S < at_s < until_s for since_s, until_s in [*self._quiet, (self._stopped_s, np.inf)]):
            found.append("it was sent after a stop, and it had not been asked for since")
        known, target = target_of(trajectory, statuses)
        if not known:
            found.append("no status tells what it is for")
        elif self.world is not None:
            hit = self.contact(trajectory, target)
            if hit:
                found.append(hit)
        self._running = (at_s, trajectory, target)
        return found

    def contact(self, trajectory: Trajectory, target: np.ndarray | None, from_s: float = 0.0) -> str:
        """What a motion touches in the newest scene from a moment on, in words; empty when nothing."""
        rows = trajectory.configurations(STEP_RAD)
        if from_s > 0.0:
            rows = trajectory.sample(np.arange(from_s, trajectory.duration_s + 0.01, 0.01))
        certificate = self._checked_against(target).certify(rows)
        return "" if certificate.ok else f"{certificate.hit} at sample {certificate.index} of {len(rows)}"

    def _checked_against(self, target: np.ndarray | None) -> ExactChecker:
        assert self.world is not None
        place = () if target is None else tuple(target)
        if self._checker is None or self._checker[0] is not self.world or self._checker[1] != place:
            points = self.world.hard_points(target)
            off_arm = np.ones(len(points), dtype=bool)
            for q in self._around(self.world.since_s):
                off_arm &= self._surface.distance(points, q, within_m=PADDING_M + 0.003) > PADDING_M + 0.002
            # A tenth of a millimetre more: twigs end on the sphere, and a status rounds the target's place.
            sphere = {"exclusion_centre": target, "exclusion_radius_m": EXCLUSION_M + 1e-4, "approach_zone_m": APPROACH_M}
            self._checker = self.world, place, ExactChecker(self.robot, points[off_arm], point_radius_m=STEM_RADIUS_M, **sphere)
        return self._checker[2]

    def _around(self, at_s: float) -> list[np.ndarray]:
        """Where the arm was around a moment; while it moves, it is not known here more exactly where it was at a cloud's stamp."""
        near = [q for state_s, q, _ in list(self._states) if abs(state_s - at_s) < STAMP_S]
        return near[:: max(len(near) // 12, 1)] or [q for q in (self.newest(at_s), self.newest()) if q is not None][:1]

    def blocked(self, after_s: float) -> str:
        """What the running motion will touch in the newest scene from `after_s` from now on; empty when nothing."""
        if self._running is None:
            return ""
        since_s, trajectory, target = self._running
        elapsed_s = time.monotonic() - since_s + after_s
        return "" if elapsed_s >= trajectory.duration_s else self.contact(trajectory, target, elapsed_s)

    def later(self, after_s: float) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Where the running motion will have the arm, (n,), and its target, (3,); None where nothing runs."""
        if self._running is None:
            return None, None
        since_s, trajectory, target = self._running
        return trajectory.sample(time.monotonic() - since_s + after_s), target


def status_of(trajectory: Trajectory, statuses: list[dict[str, str]]) -> dict[str, str]:
    """The newest status that belongs to a motion, empty when there is none."""
    for status in reversed(statuses):
        if '"positions"' in status.get("trajectory", ""):
            last = json.loads(status["trajectory"])["positions"][-1]
            if np.abs(np.asarray(last) - trajectory.positions[-1]).max() < 1e-5:
                return status
    return {}


def kind_of(trajectory: Trajectory, statuses: list[dict[str, str]]) -> str:
    """Which request a motion belongs to, in words."""
    status = status_of(trajectory, statuses)
    return f"{status.get('kind')} {status.get('plan_id')}"


def target_of(trajectory: Trajectory, statuses: list[dict[str, str]]) -> tuple[bool, np.ndarray | None]:
    """Find the status that belongs to a motion: (found, position of its target (3,) or None)."""
    status = status_of(trajectory, statuses)
    place = status.get("target_position")
    return bool(status), None if not place else np.array(json.loads(place))
