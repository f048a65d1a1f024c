"""The node's services: coroutines that hand a request to the worker and wait for its answer without holding the executor."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from functools import partial

import numpy as np
from nav_msgs.srv import GetPlan
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from std_srvs.srv import Trigger

from lime_planner.core.status import Status
from lime_planner.ros import qos
from lime_planner.ros.convert import to_path
from lime_planner.ros.execution.motion import Ended
from lime_planner.ros.requests.jobs import Requests
from lime_planner.ros.requests.parts import NodeParts
from lime_planner.ros.requests.request_text import about, answer_message, log_line, target_values
from lime_planner.ros.requests.status_board import Phase, severity_of
from lime_planner.ros.requests.worker import Answer, RequestContext, Ticket
from lime_planner.ros.runtime import Severity

#: From a coroutine's end to its response on the wire [s], generously.
_LEAVING_S = 0.03


class Services:
    """`~/plan`, `~/plan_and_wait`, `~/look`, `~/preview`, `~/preview_to`, `~/execute`, `~/retreat` and `~/stop`."""

    def __init__(self, parts: NodeParts, requests: Requests, log: Callable[[Severity, str], None]) -> None:
        """Open the services.

        Args:
            parts: of the node that serves them.
            requests: what each request does.
            log: writes a sentence into the log.
        """
        node = self._node = parts.node
        self._parameters = parts.parameters
        self._loader = parts.loader
        self._worker = parts.worker
        self._execution = parts.execution
        self._board = parts.board
        self._requests = requests
        self._log = log
        self._waiting = 0
        self._ends: dict[int, Future] = {}  # of motions that a caller waits for, by their request
        # Reentrant: an unanswered request must not hold back the next one.
        options = {"qos_profile": qos.SERVICE, "callback_group": ReentrantCallbackGroup()}
        for name in ("plan", "look", "preview", "execute", "retreat"):
            node.create_service(Trigger, f"~/{name}", partial(self._trigger, name, getattr(requests, name)), **options)
        node.create_service(Trigger, "~/plan_and_wait", self._plan_and_wait, **options)
        node.create_service(GetPlan, "~/preview_to", self._preview_to, **options)
        node.create_service(Trigger, "~/stop", self._stop, **options)

    def finish(self, ticket: Ticket, answer: Answer) -> None:
        """Put a request's end into status and log; from whichever thread answers."""
        try:
            motion = self._execution.motion
            own = motion is not None and motion.plan_id == ticket.plan_id
            phase, message = Phase.EXECUTING if own else Phase.DONE, answer_message(ticket, answer)
            self._board.show(ticket.plan_id, phase, answer.status, message, **target_values(ticket.context.target))
            if motion is not None and not own:
                self._board.show(motion.plan_id, Phase.EXECUTING)  # the newest status tells what the arm does
            self._log(severity_of(answer.status), log_line(ticket, answer))
        except Exception:  # the answer itself must get through
            self._log(Severity.ERROR, traceback.format_exc())

    def ended(self, ended: Ended) -> None:
        """Take in that a motion has ended; from whichever thread notices."""
        future = self._ends.get(ended.motion.plan_id)
        if future is not None and not future.done():
            future.set_result(Answer(ended.status, ended.sentence))
            self._wake()

    async def _plan_and_wait(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Plan, send, and answer when the arm rests: with the plan's code where nothing was sent, else with the motion's."""
        end, sent_as = Future(), [0]

        def job(ticket: Ticket) -> Answer:
            sent_as[0] = ticket.plan_id
            self._ends[ticket.plan_id] = end  # before the motion is sent: it may be over before its request is answered
            return self._requests.plan(ticket)

        self._waiting += 1
        try:
            ticket, answer = await self._ask("plan", job, self._requests.aim("plan"))
            if answer.status is Status.SUCCEEDED and answer.moves:
                answer = await end
        finally:
            self._waiting -= 1
            self._ends.pop(sent_as[0], None)
        response.success = bool(answer.status is Status.SUCCEEDED)
        response.message = answer_message(ticket, answer)
        return response

    async def _trigger(
        self, kind: str, job: Callable[[Ticket], Answer], _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        ticket, answer = await self._ask(kind, job, self._requests.aim(kind))
        response.success = bool(answer.status is Status.SUCCEEDED)
        response.message = answer_message(ticket, answer)
        return response

    async def _preview_to(self, request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        job = partial(self._requests.preview_to, goal=request.goal)
        _, answer = await self._ask("preview_to", job, self._requests.aim("preview_to", request.goal))
        poses = answer.tool_path if answer.status is Status.SUCCEEDED and answer.tool_path is not None else np.empty((0, 7))
        loaded = self._loader.loaded
        response.plan = to_path(poses, loaded.robot.planning_frame if loaded is not None else "", self._node.get_clock().now().to_msg())
        return response

    async def _ask(self, kind: str, job: Callable[[Ticket], Answer], context: RequestContext) -> tuple[Ticket, Answer]:
        future = Future()

        def on_answer(ticket: Ticket, answer: Answer) -> None:
            self.finish(ticket, answer)
            future.set_result((ticket, answer))
            self._wake()

        self._waiting += 1
        try:
            self._worker.submit(kind, job, on_answer, context)
            result: tuple[Ticket, Answer] = await future
        finally:
            self._waiting -= 1
        return result

    def _wake(self) -> None:
        executor = self._node.executor
        if executor is not None:
            executor.wake()  # it looks at waiting coroutines whenever it wakes

    def drain(self, timeout_s: float) -> None:
        """Give answers that are made the time to leave, while the executor still spins."""
        for end in list(self._ends.values()):
            if not end.done():
                end.set_result(Answer(Status.CANCELLED, "the planner node shuts down"))
        self._wake()
        deadline = time.monotonic() + timeout_s
        while self._waiting and time.monotonic() < deadline:
            time.sleep(0.005)
        time.sleep(_LEAVING_S)

    def _stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Stop and cancel; the hold is sent from here, in the executor's thread, whatever the worker is doing."""
        try:
            response.success, response.message = True, Status.SUCCEEDED.message(self.stop_everything())
        except Exception as error:
            self._log(Severity.ERROR, traceback.format_exc())
            response.success, response.message = False, Status.INTERNAL_ERROR.message(f"{type(error).__name__}: {error}")
        return response

    def stop_everything(self) -> str:
        """Stop a motion and cancel every request; from any thread. What was stopped, in words."""
        moving = self._execution.stop(Status.CANCELLED, "stopped by ~/stop")
        foreign = "" if moving else self._execution.hold_foreign_motion(self._parameters.snapshot)
        cancelled = self._worker.cancel("stopped by ~/stop")
        # A request that had committed before it could be cancelled has sent its motion by now, or holds the lock to do so.
        moving = self._execution.stop(Status.CANCELLED, "stopped by ~/stop") or moving
        words = "the motion is being stopped" if moving else foreign or "no motion was running"
        sentence = f"{words}; {cancelled} request(s) cancelled {self._about_the_stopped()}"
        self._log(Severity.OK, f"stop: {Status.SUCCEEDED.message(sentence)}")
        return sentence

    def _about_the_stopped(self) -> str:
        """Name the motion that is being stopped, else the newest request."""
        motion, ticket = self._execution.ending, self._worker.newest
        if motion is not None:
            return about(motion.plan_id, motion.target)
        return about(0, None) if ticket is None else about(ticket.plan_id, ticket.context.target)
