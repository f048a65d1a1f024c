"""What the page asks of what plans and moves: a scene file's backend (`lime_planner.viewer.scene_backend`) or a running planner node.

The page looks at one immutable `Moment` some twenty times a second and compares what it holds by identity; it never waits for the
backend, nor the backend for it.
"""

from __future__ import annotations

import dataclasses
import enum
from dataclasses import dataclass, field
from typing import Any, Protocol

from lime_planner.core.parameters import Settings, validate
from lime_planner.core.types import Array
from lime_planner.pipeline import Pipeline
from lime_planner.pipeline.result import PlanRecord
from lime_planner.robot.model import Robot
from lime_planner.scene.scene import Scene


class Activity(enum.Enum):
    """What goes on, in words."""

    LOADING = "Getting ready"
    IDLE = "Ready"
    PLANNING = "Planning"
    MOVING = "The arm moves"
    STOPPING = "The arm stops"


@dataclass(frozen=True, eq=False)
class Moment:
    """Everything there is to see now.

    Attributes:
        activity: what goes on.
        message: the newest outcome, `CODE: sentence`, or what is being waited for.
        robot, pipeline: None until they are loaded.
        scene: None as long as there is none.
        target: (7,) pose of the target, None as long as there is none.
        q: (n,) measured configuration [rad], None where unknown.
        shown: the newest plan, None before the first.
        moving_s: how long the motion of `shown` has run [s]; None when none runs.
        settings: parameters of the next plan, without the page's own wishes.
        blocked_plan, blocked_motion, blocked_retreat: why the arm cannot be planned for, moved, or led back now; empty where it can.
        advice: what to do, where there is nothing to see yet.
        doubts: sentences about scene, target and start that are hardly meant, as a plan would give them.
    """

    activity: Activity
    message: str
    settings: Settings
    robot: Robot | None = None
    pipeline: Pipeline | None = None
    scene: Scene | None = None
    target: Array | None = None
    q: Array | None = None
    shown: PlanRecord | None = None
    moving_s: float | None = None
    blocked_plan: str = ""
    blocked_motion: str = ""
    blocked_retreat: str = ""
    advice: str = ""
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Wishes:
    """What the page's controls ask of the next plan.

    Attributes:
        parameters: names and values of changed parameters.
        target: (7,) pose that the target was dragged to; None for the one that is there.
        fruit: (3,) centre of a fruit that was clicked, to be grasped as is best; None for none.
    """

    parameters: dict[str, Any] = field(default_factory=dict)
    target: Array | None = None
    fruit: Array | None = None


def with_wishes(settings: Settings, wishes: Wishes) -> Settings:
    """Return the settings with the wishes in them.

    Raises:
        ParameterError: a value that is not allowed.
    """
    return dataclasses.replace(settings, **{name: validate(name, value) for name, value in wishes.parameters.items()})


class Backend(Protocol):
    """Plans and moves for the page. Every method returns at once and may be called from any thread."""

    #: Where plans come from and motions go to, for the page's heading.
    title: str
    #: Whether an executed motion leaves this program: for an arm, or for a simulation that plays one.
    real: bool
    #: Whether a browser is open; set by the page.
    watched: bool

    @property
    def places(self) -> bool:
        """Whether `place` puts the arm somewhere."""
        ...

    @property
    def opens(self) -> bool:
        """Whether `open` takes another scene."""
        ...

    def moment(self) -> Moment:
        """Return what there is to see now."""
        ...

    def plan(self, wishes: Wishes) -> None:
        """Make a plan and show it; nothing moves."""
        ...

    def execute(self, number: int) -> None:
        """Carry the plan of that number out, if it still is the newest one."""
        ...

    def retreat(self) -> None:
        """Lead the arm back along the last motion."""
        ...

    def place(self, q: Array) -> None:
        """Put a simulated arm into a configuration (n,) [rad], without a motion."""
        ...

    def stop(self) -> None:
        """Stop planning, and the arm."""
        ...

    def open(self, scene: Scene, title: str) -> None:
        """Take another scene."""
        ...
