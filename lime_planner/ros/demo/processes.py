"""The demo's nodes as processes of their own: started in a part of the ROS graph of their own, ended whatever happens."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lime_planner.core.errors import LimePlannerError, ParameterError
from lime_planner.core.status import Status

_END_TIMEOUT_S = 6.0
_HIGHEST_DOMAIN = 232
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


class DemoError(LimePlannerError):
    """Why the demo cannot go on, in one sentence."""

    def __init__(self, sentence: str, status: Status = Status.NOT_READY) -> None:
        """Keep the sentence, and the code that it is printed with."""
        super().__init__(sentence)
        self.status = status


@dataclass(frozen=True)
class Corner:
    """A place in the ROS graph for one demo.

    The namespace belongs to this process alone, and so does the domain unless ROS_DOMAIN_ID names one: neither another demo nor a
    real arm on this machine can take the demo's motion command for its own.
    """

    domain: int
    namespace: str

    @classmethod
    def own(cls) -> Corner:
        """Choose the domain that ROS_DOMAIN_ID names, else one by the process id; domains up to 101 are safe on every system.

        Raises:
            ParameterError: ROS_DOMAIN_ID is no whole number from 0 to 232.
        """
        text = os.environ.get("ROS_DOMAIN_ID", "").strip()
        if text and not (text.isascii() and text.isdigit() and int(text) <= _HIGHEST_DOMAIN):
            raise ParameterError(f"ROS_DOMAIN_ID is {text!r}; it must be a whole number from 0 to {_HIGHEST_DOMAIN}")
        return cls(int(text) if text else 1 + os.getpid() % 101, f"/lime_demo_{os.getpid()}")

    def environment(self) -> dict[str, str]:
        """Return the environment of the demo's processes: this machine only."""
        return {**os.environ, "ROS_DOMAIN_ID": str(self.domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONUNBUFFERED": "1"}


def ros_value(value: Any) -> str:
    """Write a parameter's value as `-p name:=value` understands it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(ros_value(item) for item in value) + "]"
    if isinstance(value, float):
        return repr(value)
    # Quoted, so that a text such as 1e5 or true stays text.
    return '"' + str(value).replace("\\", "\\\\").replace('"', '\\"') + '"' if isinstance(value, str) else str(value)


class Processes:
    """The nodes that run for the demo; a context manager that ends them all."""

    def __init__(self, corner: Corner, logs: Path) -> None:
        """Prepare.

        Args:
            corner: where the nodes meet.
            logs: folder for one log file for each node.
        """
        self._corner = corner
        self._logs = logs
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        logs.mkdir(parents=True, exist_ok=True)

    def start(self, name: str, module: str, parameters: Mapping[str, Any], arguments: Sequence[str] = ()) -> None:
        """Start a node as `python -m MODULE` with ROS parameters; from the main thread."""
        # ROS has no way to write an empty list here; it is every list's default.
        given = {key: value for key, value in parameters.items() if value != []}
        pairs = [word for key, value in given.items() for word in ("-p", f"{key}:={ros_value(value)}")]
        command = [sys.executable, "-m", module, *arguments, "--ros-args", "-r", f"__ns:={self._corner.namespace}", *pairs]
        with open(self._log(name), "wb") as log:
            self._running[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._corner.environment(),
                start_new_session=True,  # Ctrl-C reaches the demo, which ends its nodes in order
                preexec_fn=_die_with_parent,
            )

    def check(self) -> None:
        """Notice a node that has ended.

        Raises:
            DemoError: with the end of its log.
        """
        for name, process in self._running.items():
            code = process.poll()
            if code is not None:
                lines = self._log(name).read_text(encoding="utf-8", errors="replace").strip().splitlines()
                last = next((line for line in reversed(lines) if line.strip()), "it printed nothing")
                raise DemoError(f"{name} ended with code {code}: {last.strip()} (the rest is in {self._log(name)})", Status.INTERNAL_ERROR)

    def __enter__(self) -> Processes:
        """Nothing to do: nodes are started one by one."""
        return self

    def __exit__(self, *_: object) -> None:
        """End every node: ask, wait, insist."""
        for process in self._running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + _END_TIMEOUT_S
        for process in self._running.values():
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _log(self, name: str) -> Path:
        return self._logs / f"{name}.log"


def _die_with_parent() -> None:
    """Let the kernel end the node when the demo is killed in a way it cannot answer."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
