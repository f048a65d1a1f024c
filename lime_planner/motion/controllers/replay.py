"""What each controller makes of a motion command: the laws by which they move, defects included, without an arm and without ROS.

The Kinova law is the loop of the Gen2 driver (Kinovarobotics/kinova-ros, `kinova_joint_trajectory_controller.cpp`): a timer sends
the velocity of the current point every 10 ms and then moves on by one point if that point's time has passed since the command came.
A new command replaces the points and restarts the clock but not the index. Past the last point the timer stops without a word:

- having run through the points, it leaves the arm with the last one's velocity, which is why that must be zero;
- with an index already beyond a shorter new command it sends nothing of that command and the arm halts, which is what makes a single
  point a stop. (Whether an arm that is sent nothing goes on or halts is its firmware's; the law takes the worse of both for a motion.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from lime_planner.core.errors import ProblemError
from lime_planner.core.types import Array
from lime_planner.motion.trajectory import Trajectory

TICK_S = 0.01  #: period of the driver's velocity timer
_ROUNDING_S = 1e-6  # a timer is never early: a point whose time is the tick's has passed


class KinovaLaw:
    """The driver's loop: which velocity it sends at every tick."""

    def __init__(self, joints: int) -> None:
        """Start idle.

        Args:
            joints: number of joints n.
        """
        self._times_s: Array = np.zeros(0)
        self._velocities: Array = np.zeros((0, joints))
        self._sent: Array = np.zeros(joints)
        self._index = 0
        self._clock_s = 0.0
        self._running = False
        self._skipped = False

    @property
    def index(self) -> int:
        """The point whose velocity goes out next."""
        return self._index

    @property
    def running(self) -> bool:
        """Whether the timer runs, which is until one tick after the last point has passed."""
        return self._running

    def command(self, times_s: npt.ArrayLike, velocities: npt.ArrayLike) -> None:
        """Take a command, as the driver does: the point index stays where it is.

        Args:
            times_s: time of every point after now [s], (K,).
            velocities: [rad/s], (K, n).
        """
        self._times_s = np.array(times_s, dtype=np.float64)
        self._velocities = np.array(velocities, dtype=np.float64)
        self._clock_s = 0.0
        self._running = True
        self._skipped = self._index >= len(self._times_s)

    def tick(self) -> Array:
        """Let one period of the timer pass and return the velocity the arm has from here to the next tick [rad/s], (n,)."""
        self._clock_s += TICK_S
        if self._running:
            if self._index < len(self._times_s):
                self._sent = self._velocities[self._index]
                if self._clock_s >= self._times_s[self._index] - _ROUNDING_S:
                    self._index += 1
            else:
                self._index = 0
                self._running = False
                if self._skipped:
                    self._sent = np.zeros_like(self._sent)
        return self._sent


def replay_kinova(
    commands: Trajectory | Sequence[tuple[float, Trajectory]], *, q_start: npt.ArrayLike | None = None, settle_s: float = 0.1
) -> tuple[Array, Array]:
    """Carry out commands by the Kinova law.

    Args:
        commands: one motion, sent at t = 0, or several with the times at which they are sent [s], ascending.
        q_start: configuration at t = 0 [rad], (n,); the first motion's first point by default.
        settle_s: how long to go on after the end of the last command [s].

    Returns:
        Times of the ticks [s], (R,), and the configuration at each [rad], (R, n), from t = 0.

    Raises:
        ProblemError: no command, or times that do not ascend from 0.
    """
    queue = [(0.0, commands)] if isinstance(commands, Trajectory) else list(commands)
    if not queue:
        raise ProblemError("replay_kinova needs at least one command")
    sent_at = [time_s for time_s, _ in queue]
    if sent_at[0] < 0.0 or sorted(sent_at) != sent_at:
        raise ProblemError(f"the commands' times must ascend from 0 or later, got {sent_at}")
    first = queue[0][1]
    law = KinovaLaw(len(first.joint_names))
    q = np.array(first.positions[0] if q_start is None else q_start, dtype=np.float64)
    # A kept index holds a point's velocity until its time, so the motion ends with the last command's last time at the latest.
    ticks = int(np.ceil((queue[-1][0] + queue[-1][1].duration_s + settle_s) / TICK_S))
    configurations = np.empty((ticks + 1, len(q)))
    configurations[0] = q
    for tick in range(ticks):
        while queue and queue[0][0] <= tick * TICK_S + _ROUNDING_S:
            _, trajectory = queue.pop(0)
            law.command(trajectory.times(), trajectory.velocities)
        q = q + law.tick() * TICK_S
        configurations[tick + 1] = q
    return TICK_S * np.arange(ticks + 1, dtype=np.float64), configurations


def replay_jtc(trajectory: Trajectory, *, q_start: npt.ArrayLike | None = None, step_s: float = 0.001) -> tuple[Array, Array]:
    """Carry out a motion as a ROS 2 joint trajectory controller does: the cubic between two points.

    A first point later than t = 0 is reached by a cubic from `q_start` at rest, as the controller does from the measured state.

    Args:
        trajectory: the motion.
        q_start: configuration at t = 0 [rad], (n,); the first point by default.
        step_s: spacing of the result [s].

    Returns:
        Times [s], (R,), and the configuration at each [rad], (R, n), from t = 0 to the end of the motion.
    """
    t_s = np.linspace(0.0, trajectory.duration_s, max(2, int(np.ceil(trajectory.duration_s / step_s)) + 1))
    q = trajectory.sample(t_s)
    before = t_s < trajectory.first_time_s
    if q_start is not None and before.any():
        approach = Trajectory(
            trajectory.joint_names,
            trajectory.first_time_s,
            np.stack([np.asarray(q_start, dtype=np.float64), trajectory.positions[0]]),
            np.stack([np.zeros_like(trajectory.velocities[0]), trajectory.velocities[0]]),
        )
        q[before] = approach.sample(t_s[before])
    return np.asarray(t_s, dtype=np.float64), q
