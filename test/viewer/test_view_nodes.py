"""The planner node's own page, with real nodes, in a real browser: plan, confirm, move, stop; and nothing left behind."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="the nodes need ROS 2 (extra `ros`, or a sourced installation)")

from browser import Tab, chromium
from test_demo import nodes_of

ROOT = Path(__file__).resolve().parents[2]
#: Compiling everything in an empty cache takes minutes on two slow cores.
READY_S = 420.0


class View:
    """`lime-planner view --nodes` in a process of its own."""

    def __init__(self, *arguments: str) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        command = [sys.executable, "-m", "lime_planner", "view", "--nodes", "--no-browser", "--port", str(self.port), *arguments]
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    def wait_for(self, text: str, timeout_s: float) -> None:
        deadline = time.monotonic() + timeout_s
        while not any(text in line for line in self.lines):
            assert self.process.poll() is None, "\n".join(self.lines)
            assert time.monotonic() < deadline, "\n".join(self.lines)
            time.sleep(0.05)

    @property
    def namespace(self) -> str:
        return re.findall(r"/lime_demo_\d+", "\n".join(self.lines))[0]

    def end(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        code = self.process.wait(30.0)
        self._reader.join(5.0)
        return code


@pytest.fixture
def view() -> Iterator[View]:
    running = View("--set", "velocity_scaling=0.1")  # long enough on the way for a browser that draws by software
    yield running
    if running.process.poll() is None:
        running.process.kill()


def test_plan_move_and_stop(view: View) -> None:
    view.wait_for("the page is at", READY_S)
    with chromium() as browser:
        tab = Tab(browser, f"http://127.0.0.1:{view.port}/")
        tab.press("Plan", READY_S)
        tab.sees("A path is found; nothing has moved.")
        tab.press("Execute")
        tab.sees("Is everyone out of its reach?")
        tab.press("Move the arm")
        tab.sees("The arm moves")
        tab.press("Stop")
        tab.sees("CANCELLED")
        tab.sees("Ready")
        assert tab.page.get_by_role("button", name="Execute", exact=True).is_disabled()  # the plan is used up
        assert tab.complaints == []
        tab.close()
    namespace = view.namespace
    assert len(nodes_of(namespace)) == 3
    assert view.end() == 0, "\n".join(view.lines)
    assert nodes_of(namespace) == []
    assert not any("Traceback" in line for line in view.lines)
