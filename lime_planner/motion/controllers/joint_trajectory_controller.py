"""The sampling law of a ROS 2 joint trajectory controller: splines between the points, from wherever the arm is."""

from __future__ import annotations

import numpy as np

from lime_planner.core.types import Array, Bool
from lime_planner.motion.controllers.command import Command


class JtcLaw:
    """One accepted command being carried out.

    Between two points positions are interpolated linearly, with velocities cubically, with accelerations as well quintically. Before
    a first point later than the start, the arm is brought there from the state it was in. On continuous joints that state is shifted
    by whole turns next to the first point; all later points are taken as they are.
    """

    def __init__(self, command: Command, joint_names: tuple[str, ...], q_start: Array, v_start: Array, continuous: Bool) -> None:
        """Begin.

        Args:
            command: an accepted command.
            joint_names: the arm's joints.
            q_start: configuration on arrival [rad], (n,).
            v_start: velocity on arrival [rad/s], (n,).
            continuous: which joints turn without end, (n,).
        """
        order = [command.joint_names.index(name) for name in joint_names]
        positions = np.array(command.positions, dtype=np.float64)[:, order]
        delay_s = command.start_s or 0.0
        turns = np.where(continuous, np.round((positions[0] - q_start) / (2.0 * np.pi)), 0.0)
        self.q_start = q_start + 2.0 * np.pi * turns
        self._times_s = np.array(command.times_s, dtype=np.float64) + delay_s
        self._rows = [positions]
        for rows in (command.velocities, command.accelerations):
            if not rows or not all(rows):
                break
            self._rows.append(np.array(rows, dtype=np.float64)[:, order])
        before = [self.q_start, v_start, np.zeros_like(q_start)]
        if self._times_s[0] > 0.0:
            self._times_s = np.concatenate([[0.0], self._times_s])
            self._rows = [np.vstack([state, rows]) for state, rows in zip(before, self._rows, strict=False)]

    @property
    def duration_s(self) -> float:
        """Time of the last point after the arrival [s]."""
        return float(self._times_s[-1])

    def sample(self, t_s: float) -> Array:
        """Return the commanded configuration at t_s after the arrival [rad], (n,)."""
        times = self._times_s
        if t_s >= times[-1] or len(times) == 1:
            return np.array(self._rows[0][-1])
        i = max(int(np.searchsorted(times, t_s, side="right")) - 1, 0)
        h = float(times[i + 1] - times[i])
        x = min(max((t_s - times[i]) / h, 0.0), 1.0)
        start = [rows[i] * h**k for k, rows in enumerate(self._rows)]
        end = [rows[i + 1] * h**k for k, rows in enumerate(self._rows)]
        d = end[0] - start[0]
        if len(self._rows) == 1:
            value = start[0] + x * d
        elif len(self._rows) == 2:
            value = start[0] + x * (start[1] + x * (3.0 * d - 2.0 * start[1] - end[1] + x * (start[1] + end[1] - 2.0 * d)))
        else:
            (v0, a0), (v1, a1) = start[1:], end[1:]
            c3 = 10.0 * d - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
            c4 = -15.0 * d + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
            c5 = 6.0 * d - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1
            value = start[0] + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
        return np.asarray(value, dtype=np.float64)
