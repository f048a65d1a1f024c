"""A finished plan together with what it was made of: what pictures, animations and the page are drawn from."""

from __future__ import annotations

from dataclasses import dataclass

from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array
from lime_planner.pipeline.result import PlanResult
from lime_planner.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class PlanRecord:
    """A finished plan with what it was made of.

    Attributes:
        number: tells plans apart; what Execute is confirmed for.
        scene, settings: as used.
        target: (7,) pose of the tool at the fruit, T_base_tool; None for a motion without one (a retreat).
        result: of any status.
    """

    number: int
    scene: Scene
    settings: Settings
    target: Array | None
    result: PlanResult

    @property
    def found(self) -> bool:
        """Whether there is a path to be shown."""
        return len(self.result.waypoints) > 1
