"""What the soak test picks from: faults of the arm, settings good and bad, and the limits in time."""

from __future__ import annotations

import math
from typing import Any

ANSWER_S = 20.0  # later than this an answer is lost
ARRIVED_RAD = 0.02  # from a motion's last point, when it has succeeded
STEM_STOP_S = 1.5  # a stem on the rest of the path must have stopped the arm by then
#: What the scene node is given besides seed and density.
SCENE: dict[str, Any] = {
    "file": "",
    "label_field": "label",
    "scale": 1.0,
    "offset": [0.0, 0.0, 0.0],
    "target": [],
    "approach": "fixed",
    "rate_hz": 0.0,
}
#: No fault at all.
CALM: dict[str, Any] = {
    "noise_rad": 0.0,
    "lag_s": 0.0,
    "gain_error": 0.0,
    "speed_scaling": 1.0,
    "drop_probability": 0.0,
    "state_delay_s": 0.0,
    "stall_at_fraction": 0.0,
    "report_wrapped": False,
}
FAULTS: tuple[dict[str, Any], ...] = (
    {"noise_rad": 0.0005},
    {"lag_s": 0.1},
    {"gain_error": 0.05},
    {"gain_error": -0.3},
    {"speed_scaling": 0.9},
    {"speed_scaling": 0.5},
    {"report_wrapped": True},
    {"drop_probability": 0.5},
    {"drop_probability": 1.0},
    {"state_delay_s": 0.1},
    {"state_delay_s": 1.0},
    {"stall_at_fraction": 0.5},
    {"shuffle": True},
    {"extra_joints": ["gripper", "camera"]},
)
SETTINGS: tuple[dict[str, Any], ...] = (
    {"time_budget_s": 0.1},
    {"time_budget_s": 0.5},
    {"velocity_scaling": 0.6},
    {"velocity_scaling": 1.0},
    {"leaf_speed_scale": 0.5},
    {"leaf_speed_scale": 1.0},
    {"leaf_cost": "graded"},
    {"leaf_cost": "binary"},
    {"deadline_s": 1.0},
    {"deadline_s": 0.0},
    {"replan_attempts": 2},
    {"replan_attempts": 0},
    {"trajectory_dt_s": 0.01},
    {"trajectory_dt_s": 0.02},
)
BAD_SETTINGS: tuple[dict[str, Any], ...] = (
    {"time_budget_s": -1.0},
    {"planner": "magic"},
    {"velocity_scaling": math.nan},
    {"workspace_box": [1.0]},
    {"robot": "other"},
)
