"""What the node tells about itself: the status of the newest request, and the health of the inputs."""

from __future__ import annotations

import enum
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from lime_planner.core.status import Status

#: Outcomes that need nobody's attention.
_QUIET = (Status.SUCCEEDED, Status.PREEMPTED, Status.CANCELLED)


class Phase(enum.Enum):
    """What a request is going through."""

    IDLE = "no request yet"
    PLANNING = "a path is being planned or checked"
    STOPPING = "a motion is being stopped, or the arm's rest awaited"
    EXECUTING = "the arm moves"
    DONE = "the request has ended, and its motion if there was one"


def text(value: Any) -> str:
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


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _rounded(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return np.round(value, 6).tolist() if value.dtype.kind == "f" else value.tolist()
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return round(float(value), 6)
    return value.item() if isinstance(value, np.generic) else value


def _level(code: Status | None) -> bytes:
    if code is None or code in _QUIET:
        return DiagnosticStatus.OK
    return DiagnosticStatus.ERROR if code is Status.INTERNAL_ERROR else DiagnosticStatus.WARN


def status_message(
    stamp: Time, name: str, robot: str, phase: Phase, code: Status | None, message: str, values: Mapping[str, Any]
) -> DiagnosticArray:
    """Make the `~/status` message.

    Args:
        stamp: now.
        name: the node's name.
        robot: the robot's name.
        phase: what the request goes through.
        code: its outcome so far.
        message: `CODE: sentence`, or the phase's meaning.
        values: further figures by key.
    """
    pairs = {"phase": phase.name, "code": code.name if code is not None else "", **values}
    return _array(stamp, f"{name}: plan", robot, _level(code), message, pairs)


def health_message(stamp: Time, name: str, robot: str, trouble: str, values: Mapping[str, Any]) -> DiagnosticArray:
    """Make the 1 Hz `/diagnostics` message; `trouble` is empty when all is well."""
    return _array(stamp, f"{name}: health", robot, DiagnosticStatus.WARN if trouble else DiagnosticStatus.OK, trouble or "ok", values)


def _array(stamp: Time, name: str, hardware: str, level: bytes, message: str, values: Mapping[str, Any]) -> DiagnosticArray:
    status = DiagnosticStatus(level=level, name=name, message=message, hardware_id=hardware)
    status.values = [KeyValue(key=str(key), value=text(value)) for key, value in values.items()]
    array = DiagnosticArray(status=[status])
    array.header.stamp = stamp
    return array


def read_status(msg: DiagnosticArray) -> dict[str, str]:
    """Return the pairs of a `~/status` or health message as a dictionary; for clients and tests."""
    return {pair.key: pair.value for status in msg.status for pair in status.values}
