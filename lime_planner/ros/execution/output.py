"""Where motions go: the topic of a driver or a controller, or a joint trajectory controller's action, which says what became of them."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectory

from lime_planner.core.status import Status
from lime_planner.motion.trajectory import Trajectory
from lime_planner.ros import qos
from lime_planner.ros.convert import to_joint_trajectory

#: The value of `controller` with which motions go by the action.
ACTION = "jtc_action"
#: A controller that has not taken the braking motion after this long is told to cancel without it [s].
_CANCEL_AFTER_S = 0.03
_ERRORS = {
    -1: "INVALID_GOAL",
    -2: "INVALID_JOINTS",
    -3: "OLD_HEADER_TIMESTAMP",
    -4: "PATH_TOLERANCE_VIOLATED",
    -5: "GOAL_TOLERANCE_VIOLATED",
}


@dataclass(frozen=True)
class Verdict:
    """What a controller said of a motion.

    Attributes:
        status: SUCCEEDED, NO_CONTROLLER where it took none of it, CANCELLED where another client took over, else EXECUTION_DEVIATED.
        sentence: the same in words.
    """

    status: Status
    sentence: str


class MotionOutput(Protocol):
    """What an execution sends its motions through; `controller` is the parameter of that name."""

    def prepare(self, trajectory: Trajectory) -> JointTrajectory:
        """Make a message of a trajectory."""

    def trouble(self, controller: str) -> str:
        """Return why nothing would carry a motion out; empty where something listens."""

    def send(self, message: JointTrajectory, controller: str, on_verdict: Callable[[Verdict], None]) -> None:
        """Put a motion on the wire; `on_verdict` is called once, from the executor's thread, by a controller that gives verdicts."""

    def stop(self, message: JointTrajectory | None, controller: str) -> None:
        """Put a braking motion on the wire, None where there is nothing to go by, and end the motion before it."""


@dataclass
class _Goal:
    """A goal that was sent to the action.

    Attributes:
        on_verdict: who hears of its end; None for a braking motion.
        answer: whether it was taken.
        handle: the goal, once it was taken.
        given_up: whether it is to be cancelled, and its end interests no more.
    """

    on_verdict: Callable[[Verdict], None] | None
    answer: Future
    handle: Any = None
    given_up: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)


class Output:
    """The node's outputs of motions: the topic `joint_trajectory`, and the action where the parameters ask for it."""

    def __init__(self, node: Node, action: str) -> None:
        """Open the topic.

        Args:
            node: the node.
            action: name of the controller's FollowJointTrajectory action.
        """
        self._node = node
        self._name = action
        self._publisher = node.create_publisher(JointTrajectory, "joint_trajectory", qos.COMMAND)
        self._kind: Any = None
        self._client: ActionClient | None = None
        self._goal: _Goal | None = None

    def use(self, controller: str) -> None:
        """Look for the action's server from now on, where the parameter `controller` asks for it; to be called in the executor's thread."""
        if controller != ACTION or self._client is not None:
            return
        try:
            self._kind = importlib.import_module("control_msgs.action").FollowJointTrajectory
        except ImportError:
            return
        self._client = ActionClient(self._node, self._kind, self._name)

    def prepare(self, trajectory: Trajectory) -> JointTrajectory:
        """Make a message of a trajectory."""
        return to_joint_trajectory(trajectory)

    def listeners(self, controller: str) -> int:
        """Return how many would carry a motion out."""
        if controller != ACTION:
            return int(self._publisher.get_subscription_count())
        return int(self._client is not None and self._client.server_is_ready())

    def trouble(self, controller: str) -> str:
        """Return why nothing would carry a motion out; empty where something listens."""
        if self.listeners(controller) > 0:
            return ""
        if controller != ACTION:
            return "joint_trajectory has no subscriber"
        if self._client is None:
            return f"controller is {ACTION}, and control_msgs is not installed: apt install ros-jazzy-control-msgs"
        return f"no controller serves the action {self._name} (parameter trajectory_action)"

    def send(self, message: JointTrajectory, controller: str, on_verdict: Callable[[Verdict], None]) -> None:
        """Put a motion on the wire."""
        if controller == ACTION:
            self._goal = self._send_goal(message, on_verdict)
        else:
            self._publisher.publish(message)

    def stop(self, message: JointTrajectory | None, controller: str) -> None:
        """Put a braking motion on the wire and cancel the one before it.

        A controller that is told to cancel holds at once what it measures, which jolts an arm in motion. So the braking motion goes
        first: it takes the other's place, and what is cancelled then is no more than its goal. Where it is not taken at once, the
        cancellation is what stops the arm.
        """
        if controller != ACTION or self._client is None:
            if message is not None:
                self._publisher.publish(message)
            return
        before = self._goal
        braking = self._goal = None if message is None else self._send_goal(message, None)
        if before is None:
            return
        if braking is None:
            self._give_up(before)
            return
        timer = threading.Timer(_CANCEL_AFTER_S, self._give_up, [before])
        timer.daemon = True
        timer.start()
        braking.answer.add_done_callback(lambda _: self._give_up(before))

    def flush(self, timeout_s: float) -> None:
        """Wait until what was sent has arrived, or the time is over."""
        goal = self._goal
        if goal is None:
            self._publisher.wait_for_all_acked(Duration(seconds=timeout_s))
            return
        end_s = time.monotonic() + timeout_s
        while not goal.answer.done() and time.monotonic() < end_s:
            time.sleep(0.005)

    def _send_goal(self, message: JointTrajectory, on_verdict: Callable[[Verdict], None] | None) -> _Goal:
        assert self._client is not None
        request = self._kind.Goal()
        request.trajectory = message
        goal = _Goal(on_verdict, self._client.send_goal_async(request))
        goal.answer.add_done_callback(lambda future: self._on_answer(goal, future))
        return goal

    def _give_up(self, goal: _Goal) -> None:
        with goal.lock:
            known, goal.given_up = goal.given_up, True
            if not known and goal.handle is not None:
                goal.handle.cancel_goal_async()

    def _on_answer(self, goal: _Goal, future: Future) -> None:
        handle = future.result()
        if handle is None or not handle.accepted:
            self._tell(goal, Verdict(Status.NO_CONTROLLER, f"the controller of {self._name} rejected the motion"))
            return
        with goal.lock:
            goal.handle = handle
            if goal.given_up:
                handle.cancel_goal_async()
        handle.get_result_async().add_done_callback(lambda result: self._on_result(goal, result))

    def _on_result(self, goal: _Goal, future: Future) -> None:
        if self._goal is goal:
            self._goal = None  # over: nothing is left to cancel
        response = future.result()
        code, words = int(response.result.error_code), str(response.result.error_string)
        if response.status == GoalStatus.STATUS_SUCCEEDED and code == 0:
            self._tell(goal, Verdict(Status.SUCCEEDED, "the controller reports success"))
        elif response.status == GoalStatus.STATUS_CANCELED:
            gone = "the controller let the motion go: it was cancelled, or another one took its place"
            self._tell(goal, Verdict(Status.CANCELLED, _joined(gone, words)))
        else:
            ended = f"the controller ended the motion: {_ERRORS.get(code, f'error {code}')}"
            self._tell(goal, Verdict(Status.EXECUTION_DEVIATED, _joined(ended, words)))

    @staticmethod
    def _tell(goal: _Goal, verdict: Verdict) -> None:
        with goal.lock:
            heard = goal.on_verdict is not None and not goal.given_up
        if heard and goal.on_verdict is not None:
            goal.on_verdict(verdict)


def _joined(sentence: str, words: str) -> str:
    return f"{sentence} ({words})" if words else sentence
