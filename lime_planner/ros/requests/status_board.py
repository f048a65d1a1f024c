"""What the node tells about itself: the status of every recent request on `~/status`, the health of the inputs on `/diagnostics`."""

from __future__ import annotations

import enum
import json
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from lime_planner.core.status import Status
from lime_planner.ros.runtime import Severity

#: Requests remembered: the running motion's and the newest ones.
_REMEMBERED = 16

#: Outcomes that are no trouble.
_QUIET = (Status.SUCCEEDED, Status.PREEMPTED, Status.CANCELLED)


class Phase(enum.Enum):
    """What a request is going through."""

    IDLE = "no request yet"
    PLANNING = "a path is being planned or checked"
    STOPPING = "a motion is being stopped, or the arm's rest awaited"
    EXECUTING = "the arm moves"
    DONE = "the request has ended, and its motion if there was one"


def text(value: object) -> str:
    """Return one value as the text of a key-value pair: numbers with at most seven digits, lists as JSON."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if value is None:
        return ""
    if isinstance(value, (float, np.floating)):
        return f"{float(value):.7g}"
    if isinstance(value, (list, tuple, dict, np.ndarray)):
        return json.dumps(_rounded(value), separators=(",", ":"))
    return str(value)


def _rounded(value: object) -> object:
    if isinstance(value, dict):
        return {str(key): _rounded(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return np.round(value, 6).tolist() if value.dtype.kind == "f" else value.tolist()
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return round(float(value), 6)
    return value.item() if isinstance(value, np.generic) else value


def severity_of(code: Status | None) -> Severity:
    """Return how bad a request's outcome is: a refused one is a warning, a defect an error."""
    if code is None or code in _QUIET:
        return Severity.OK
    return Severity.ERROR if code is Status.INTERNAL_ERROR else Severity.WARN


def status_message(
    stamp: Time, name: str, robot: str, phase: Phase, code: Status | None, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Make the `~/status` message.

    Args:
        stamp: now.
        name: the node's name, its namespace included.
        robot: the robot's name.
        phase: what the request goes through.
        code: its outcome so far.
        message: `CODE: sentence`, or the phase's meaning.
        values: further figures by key.
    """
    pairs = {"phase": phase.name, "code": code.name if code is not None else "", **values}
    return _array(stamp, f"{name}: plan", robot, severity_of(code), message, pairs)


def health_message(
    stamp: Time, name: str, robot: str, trouble: Sequence[tuple[Severity, str]], values: Mapping[str, object]
) -> DiagnosticArray:
    """Make the 1 Hz `/diagnostics` message.

    Args:
        stamp: now.
        name: the node's name, its namespace included.
        robot: the robot's name.
        trouble: what is wrong, in sentences, and how bad it is; empty when all is well.
        values: figures by key.
    """
    worst = max((severity for severity, _ in trouble), default=Severity.OK)
    return _array(stamp, f"{name}: health", robot, worst, "; ".join(sentence for _, sentence in trouble) or "ok", values)


def _array(stamp: Time, name: str, hardware: str, severity: Severity, message: str, values: Mapping[str, object]) -> DiagnosticArray:
    status = DiagnosticStatus(level=bytes([severity]), name=name, message=message, hardware_id=hardware)
    status.values = [KeyValue(key=str(key), value=text(value)) for key, value in values.items()]
    array = DiagnosticArray(status=[status])
    array.header.stamp = stamp
    return array


def read_status(msg: DiagnosticArray) -> dict[str, str]:
    """Return the pairs of a `~/status` or health message as a dictionary; for clients and tests."""
    return {pair.key: pair.value for status in msg.status for pair in status.values}


class StatusBoard:
    """The status of every recent request; used from all threads."""

    def __init__(self, name: str, now: Callable[[], Time], publish: Callable[[DiagnosticArray], None]) -> None:
        """Make an empty board and publish IDLE.

        Args:
            name: the node's name, its namespace included.
            now: the ROS time.
            publish: puts the message on the wire.
        """
        self._name = name
        self._now = now
        self._publish = publish
        self._lock = threading.Lock()
        self._records: OrderedDict[int, dict[str, object]] = OrderedDict()
        self._outcomes: dict[int, tuple[Status, str]] = {}
        self.robot = ""
        self.last_message = ""
        self.last_code: Status | None = None
        self.phase = Phase.IDLE
        self._send(Phase.IDLE, None, Phase.IDLE.value, {"plan_id": 0})

    def note(self, plan_id: int, **values: object) -> None:
        """Remember figures of a request without publishing."""
        with self._lock:
            self._record(plan_id).update(values)

    def show(self, plan_id: int, phase: Phase, code: Status | None = None, message: str | None = None, **values: object) -> None:
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
                self.last_code, self.last_message = self._outcomes[plan_id]
            known = self._outcomes.get(plan_id)
            self._send(phase, known[0] if known else None, known[1] if known else phase.value, record)

    def _record(self, plan_id: int) -> dict[str, object]:
        if plan_id not in self._records:
            self._records[plan_id] = {"plan_id": plan_id}
            while len(self._records) > _REMEMBERED:
                dropped, _ = self._records.popitem(last=False)
                self._outcomes.pop(dropped, None)
        self._records.move_to_end(plan_id)
        return self._records[plan_id]

    def _send(self, phase: Phase, code: Status | None, message: str, values: dict[str, object]) -> None:
        self.phase = phase
        self._publish(status_message(self._now(), self._name, self.robot, phase, code, message, values))
