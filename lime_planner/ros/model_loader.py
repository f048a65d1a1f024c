"""The robot model and the pipeline behind the node: loaded and warmed up in the background, exchanged while nothing uses them."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from lime_planner.collision.link_shapes import build_shapes
from lime_planner.core.elsewhere import call_elsewhere
from lime_planner.core.errors import LimePlannerError, Refusal
from lime_planner.core.parameters import Settings
from lime_planner.core.status import Status
from lime_planner.motion import stop
from lime_planner.output.console import compile_first
from lime_planner.pipeline import Pipeline
from lime_planner.robot.model import Robot, load_robot, robot_from_urdf
from lime_planner.ros.runtime import BackgroundThread, Severity, give_back

#: `robot` parameter that asks for the model from the topic `robot_description`.
FROM_TOPIC = "topic"


@dataclass(frozen=True)
class Loaded:
    """A robot model and the pipeline made of it."""

    robot: Robot
    pipeline: Pipeline

    def warm_up(self) -> None:
        """Compile what planning and stopping need."""
        compile_first()
        stop.warm_up()
        self.pipeline.warm_up()


#: Builds them: (settings, URDF text from the topic or None) -> Loaded.
Builder = Callable[[Settings, str | None], Loaded]


def build(settings: Settings, urdf: str | None) -> Loaded:
    """Load the robot of the parameters, or of a URDF's text, and make its pipeline.

    Raises:
        RobotError: the description cannot be used.
    """
    joint_names, planning_frame, tool_frame = settings.arm_joints or None, settings.planning_frame or None, settings.tool_frame or None
    # Reading meshes, finding collision pairs and measuring links hold the interpreter for seconds; a stop must not wait for that.
    robot = call_elsewhere(_read_robot, settings.robot, urdf, joint_names, planning_frame, tool_frame, settings.locked)
    return Loaded(robot, Pipeline(robot))


def _read_robot(
    name: str,
    urdf: str | None,
    joint_names: tuple[str, ...] | None,
    planning_frame: str | None,
    tool_frame: str | None,
    locked: dict[str, float],
) -> Robot:
    """Read a robot, and leave its shapes in the cache, from where `Pipeline` takes them."""
    if urdf is None:
        robot = load_robot(name, joint_names=joint_names, planning_frame=planning_frame, tool_frame=tool_frame, locked=locked)
    else:
        robot = robot_from_urdf(urdf, joint_names=joint_names, planning_frame=planning_frame, tool_frame=tool_frame, locked=locked)
    build_shapes(robot)
    return robot


class ModelLoader(BackgroundThread):
    """Loads in a thread of its own, so that the node serves from its first second."""

    def __init__(
        self,
        builder: Builder,
        settings: Settings,
        *,
        may_exchange: Callable[[], bool],
        on_loaded: Callable[[Loaded], None],
        report: Callable[[Severity, str], None],
    ) -> None:
        """Start loading.

        Args:
            builder: see `build`.
            settings: the parameters; those of the robot are fixed at start.
            may_exchange: False while a motion runs; another model is not taken in then.
            on_loaded: is told about each new model before it is used.
            report: writes a sentence into the log.
        """
        super().__init__("model loader")
        self._builder = builder
        self._settings = settings
        self._may_exchange = may_exchange
        self._on_loaded = on_loaded
        self._report = report
        self._in_use = threading.Lock()
        self._loaded: Loaded | None = None
        self._failure = ""
        self._description: str | None = None
        self._offered: str | None = None
        self._warm = False
        self.state = "waiting for robot_description" if settings.robot == FROM_TOPIC else "loading the robot"
        self._start()

    @property
    def loaded(self) -> Loaded | None:
        """The model in use, warm or not."""
        return self._loaded

    @property
    def ready(self) -> bool:
        """Whether requests are served without waiting."""
        return self._warm

    @property
    def failure(self) -> str:
        """Why the model that was asked for last cannot be used, in a sentence; empty when it can, or is still being loaded."""
        return self._failure

    def offer(self, urdf: str) -> None:
        """Take a robot description in as soon as no plan and no motion runs; the one that was offered last is not taken in twice."""
        with self._condition:
            if urdf == self._offered:  # its publisher was restarted: the way back out of the plant must not be lost for that
                return
            self._offered = self._description = urdf
            self._condition.notify_all()

    @contextlib.contextmanager
    def use(self, timeout_s: float, should_stop: Callable[[], bool]) -> Iterator[Loaded]:
        """Hold on to the model and the pipeline, waiting until they are warm.

        Args:
            timeout_s: how long to wait at most.
            should_stop: ends the wait early.

        Raises:
            Refusal: NOT_READY when it takes longer, BAD_INPUT when the robot cannot be loaded.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            with self._condition:
                while not self._warm:
                    self._check(deadline, timeout_s, should_stop)
                    self._condition.wait(0.02)
            with self._in_use:
                if self._warm and self._loaded is not None:  # else another model came in between
                    yield self._loaded
                    return

    def wait_loaded(self, timeout_s: float, should_stop: Callable[[], bool]) -> Loaded:
        """Return the model as soon as it is there, warm or not; see `use`."""
        deadline = time.monotonic() + timeout_s
        with self._condition:
            while self._loaded is None:
                self._check(deadline, timeout_s, should_stop)
                self._condition.wait(0.02)
            return self._loaded

    def _check(self, deadline: float, timeout_s: float, should_stop: Callable[[], bool]) -> None:
        if self._failure and self._description is None:
            raise Refusal(Status.BAD_INPUT, self._failure)
        if time.monotonic() >= deadline or should_stop() or self._closed:
            raise Refusal(Status.NOT_READY, f"{self.state}; waited {timeout_s:g} s")

    def _run(self) -> None:
        if self._settings.robot != FROM_TOPIC:
            self._load(None)
            return
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._closed or self._description is not None)
                if self._closed:
                    return
                urdf, self._description, self._failure = self._description, None, ""
            self._load(urdf)

    def _load(self, urdf: str | None) -> None:
        began_s = time.monotonic()
        self._say("loading the robot")
        try:
            loaded = self._builder(self._settings, urdf)
            replacing = self._warm
            if replacing:  # the model in use serves until the next one has shown that it can
                loaded.warm_up()
            if not self._exchange(loaded):
                return
            if not replacing:
                loaded.warm_up()
        except LimePlannerError as error:
            self._fail(f"the robot cannot be loaded: {error}")
        except Exception as error:
            self._fail(f"loading the robot failed with {type(error).__name__}: {error}")
        else:
            with self._condition:
                self._warm, self.state = True, "ready"
                self._condition.notify_all()
            for sentence in loaded.robot.warnings:
                self._report(Severity.WARN, f"the robot description is suspicious: {sentence}")
            self._report(Severity.OK, f"ready to plan for {loaded.robot.name} after {time.monotonic() - began_s:.1f} s")
            give_back()  # what reading and loading the kernels took

    def _exchange(self, loaded: Loaded) -> bool:
        """Take the model in while no plan and no motion runs; False when the node ends first."""
        while not self._closed:
            with self._in_use:
                if self._may_exchange():
                    self._on_loaded(loaded)
                    with self._condition:
                        self._loaded, self._failure, self._warm, self.state = loaded, "", False, "compiling the kernels"
                    return True
            time.sleep(0.05)
        return False

    def _say(self, state: str) -> None:
        with self._condition:
            if self._loaded is None:
                self.state = state

    def _fail(self, sentence: str) -> None:
        # With an older model at hand the node goes on with it, and says so in the log.
        with self._condition:
            if self._description is None:
                self._offered = None  # offered again, it is tried again
            self._failure = sentence
            if not self._warm:
                self.state = sentence
            self._condition.notify_all()
        self._report(Severity.ERROR, sentence)
