"""Options of the paper's planners: its parameters, and every choice that it leaves open, by name."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Literal

from lime_planner.core.errors import ParameterError
from lime_planner.planning.rrt_star.kernels import APF_RRT_STAR, P_RRT_STAR, RRT_STAR, Rules

#: The planners of the paper, by the names that users give.
ALGORITHMS = {"rrt_star": RRT_STAR, "apf_rrt_star": APF_RRT_STAR, "p_rrt_star": P_RRT_STAR}

_CHOICES = {
    "algorithm": tuple(ALGORITHMS),
    "step_rule": ("default", "up_to_delta", "exactly_delta"),
    "inside_leaves": ("attract", "explore"),
    "radius": ("delta", "rrg"),
    "cost": ("node", "integral"),
}


@dataclass(frozen=True)
class PaperOptions:
    """Parameters and readings of the paper's algorithms; the defaults of the readings are what reproduces its table I.

    Lengths are in the unit of the space: map units on the plane, rad for an arm.

    Attributes:
        algorithm: `rrt_star`, `apf_rrt_star` or `p_rrt_star`.
        delta: step δ, and the neighbours' radius.
        c_perm: C_perm of a node in a leaf of intensity 1 (equation 1).
        beta: β of equation 6 (APF-RRT*).
        k_att: K_att of equation 3.
        k_rep_permeable: K_rep of equation 4 for permeable obstacles.
        k_rep_impermeable: K_rep for impermeable obstacles.
        d_star: d* of equation 4, in the unit of the obstacles' distance (map units; m for an arm).
        shift: Δ of P-RRT*, one step of a sample down the field.
        shift_steps: k of P-RRT*, their number.
        propagate: hand a rewired node's new cost on to its descendants. The paper's pseudocode does not say so.
        step_rule: `up_to_delta` stops at the sample, `exactly_delta` may pass it; `default`: exactly δ for APF-RRT* (section III-B:
            "by a fixed distance δ"), up to δ for the others (as is usual for RRT*).
        near_is_neighbour: q_near always counts as a neighbour of q_new, whatever rounding makes of their distance.
        inside_leaves: the repulsion is singular inside an obstacle and left out there. `attract`: the attraction alone remains and
            biases the extension (which gives table I); `explore`: λ = 1, as the text of section III-B suggests.
        goal_radius: a node within it may become the goal's parent; None: 5/3 δ (5 on the wall).
        goal_bias: probability that a goal is the sample.
        free_samples: reject samples inside impermeable obstacles (line 3 read literally) instead of extending towards them.
        radius: `delta`: r = δ; `rrg`: max(δ, rrg_gamma (ln n / n)^(1/dimensions)).
        rrg_gamma: γ of the RRG radius (138 suits the wall); radius_limit: its largest value, None: none.
        cost: `node`: equation 2; `integral`: length + weight × length inside leaves along the edges, which are also certified.
        weight: leaf weight of the integral; None: c_perm / δ.
        certify_edges: with node costs, refuse edges that pass through impermeable obstacles; the paper checks nodes only.
    """

    algorithm: Literal["rrt_star", "apf_rrt_star", "p_rrt_star"] = "apf_rrt_star"
    delta: float = 3.0
    c_perm: float = 100.0
    beta: float = 1.0
    k_att: float = 50.0
    k_rep_permeable: float = 500.0
    k_rep_impermeable: float = 500.0
    d_star: float = 5.0
    shift: float = 0.5
    shift_steps: int = 10
    propagate: bool = False
    step_rule: Literal["default", "up_to_delta", "exactly_delta"] = "default"
    near_is_neighbour: bool = True
    inside_leaves: Literal["attract", "explore"] = "attract"
    goal_radius: float | None = None
    goal_bias: float = 0.0
    free_samples: bool = False
    radius: Literal["delta", "rrg"] = "delta"
    rrg_gamma: float = 138.0
    radius_limit: float | None = None
    cost: Literal["node", "integral"] = "node"
    weight: float | None = None
    certify_edges: bool = False

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            ParameterError: names the field, its value and what is allowed.
        """
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise ParameterError(f"{name} must be one of {', '.join(choices)}, got {getattr(self, name)!r}")
        positive = ("delta", "d_star", "rrg_gamma", "radius_limit", "goal_radius")
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, (str, bool)) or value is None:
                continue
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and f.name in positive):
                limit = "greater than 0" if f.name in positive else "at least 0"
                raise ParameterError(f"{f.name} must be finite and {limit}, got {value!r}")
        if self.goal_bias > 1.0:
            raise ParameterError(f"goal_bias must be at most 1, got {self.goal_bias!r}")

    @classmethod
    def wall(cls, algorithm: str, **changes: Any) -> PaperOptions:
        """Return the parameters of the wall experiment (section IV), with changes."""
        return cls(**{"algorithm": algorithm, **changes})

    @classmethod
    def arm(cls, algorithm: str, **changes: Any) -> PaperOptions:
        """Return the parameters of the arm experiment (section V), with changes: radians, and metres for distances to the cloud.

        The paper gives δ 0.1 rad, C_perm 100, β 1, Δ 0.1 rad and k 2, and no gains for the field. Here K_att is 50 cost/rad², K_rep
        2e-4 cost·m² for leaves and stems, and d* 0.1 m: as on the wall, attraction and repulsion then balance at about a tenth
        of d*, 1 cm, when the goal is 1 rad away and the nearest point moves 0.5 m for each radian. λ = 1 inside obstacles.
        """
        settings: dict[str, Any] = {"delta": 0.1, "shift": 0.1, "shift_steps": 2, "d_star": 0.1, "inside_leaves": "explore"}
        settings |= {"k_rep_permeable": 2e-4, "k_rep_impermeable": 2e-4}
        return cls(**{"algorithm": algorithm, **settings, **changes})

    @property
    def leaf_weight(self) -> float:
        """Weight of one unit of length inside leaves in J."""
        return self.c_perm / self.delta if self.weight is None else self.weight

    def rules(self) -> Rules:
        """Return the options in the form that compiled code takes."""
        rule = self.step_rule
        if rule == "default":
            rule = "exactly_delta" if self.algorithm == "apf_rrt_star" else "up_to_delta"
        return Rules(
            algorithm=ALGORITHMS[self.algorithm],
            delta=float(self.delta),
            full_step=rule == "exactly_delta",
            c_perm=float(self.c_perm),
            weight=float(self.leaf_weight),
            integral=self.cost == "integral",
            certify=self.certify_edges,
            propagate=self.propagate,
            near_is_neighbour=self.near_is_neighbour,
            rrg_gamma=float(self.rrg_gamma) if self.radius == "rrg" else 0.0,
            radius_limit=math.inf if self.radius_limit is None else float(self.radius_limit),
            free_samples=self.free_samples,
            goal_radius=float(5.0 / 3.0 * self.delta if self.goal_radius is None else self.goal_radius),
            shift=float(self.shift),
            shift_steps=int(self.shift_steps),
        )
