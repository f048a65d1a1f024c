"""Keeps what is known about each request and publishes `~/status` whenever a request changes its phase."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray

from lime_planner.core.status import Status
from lime_planner.ros.requests.status import Phase, status_message

#: Requests remembered: the running motion's and the newest ones.
_KEPT = 16


class Board:
    """The status of every recent request; used from all threads."""

    def __init__(self, name: str, now: Callable[[], Time], publish: Callable[[DiagnosticArray], None]) -> None:
        """Make an empty board and publish IDLE.

        Args:
            name: the node's name.
            now: the ROS time.
            publish: puts the message on the wire.
        """
        self._name = name
        self._now = now
        self._publish = publish
        self._lock = threading.Lock()
        self._records: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._outcomes: dict[int, tuple[Status, str]] = {}
        self.robot = ""
        self.last_message = ""
        self.phase = Phase.IDLE
        self._send(Phase.IDLE, None, Phase.IDLE.value, {"plan_id": 0})

    def note(self, plan_id: int, **values: Any) -> None:
        """Remember figures of a request without publishing."""
        with self._lock:
            self._record(plan_id).update(values)

    def show(self, plan_id: int, phase: Phase, code: Status | None = None, message: str | None = None, **values: Any) -> None:
        """Publish a request's phase.

        Args:
            plan_id: the request.
            phase: what it goes through now.
            code: its outcome; the one shown before stays when there is none.
            message: `CODE: sentence` that belongs to `code`.
            **values: figures to remember with it.
        """
        with self._lock:
            record = self._record(plan_id)
            record.update(values)
            if code is not None:
                self._outcomes[plan_id] = (code, message or code.message(code.value))
                self.last_message = self._outcomes[plan_id][1]
            known = self._outcomes.get(plan_id)
            self._send(phase, known[0] if known else None, known[1] if known else phase.value, record)

    def _record(self, plan_id: int) -> dict[str, Any]:
        if plan_id not in self._records:
            self._records[plan_id] = {"plan_id": plan_id}
            while len(self._records) > _KEPT:
                dropped, _ = self._records.popitem(last=False)
                self._outcomes.pop(dropped, None)
        self._records.move_to_end(plan_id)
        return self._records[plan_id]

    def _send(self, phase: Phase, code: Status | None, message: str, values: dict[str, Any]) -> None:
        self.phase = phase
        self._publish(status_message(self._now(), self._name, self.robot, phase, code, message, values))
