"""Signals end a wait whoever receives them, and whenever they come."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest
from domains import DOMAIN

from lime_planner.core.signals import EndSignals


@pytest.fixture
def signals() -> Iterator[EndSignals]:
    waiting = EndSignals()
    yield waiting
    waiting.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_another_thread_receives_ends_the_wait(signals: EndSignals, number: int) -> None:
    other = threading.Timer(0.2, lambda: signal.pthread_kill(threading.get_ident(), number))
    other.start()
    assert signals.wait(20.0)
    other.join()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_before_the_wait_counts_and_goes_on_counting(signals: EndSignals, number: int) -> None:
    assert not signals.wait(0.0)
    os.kill(os.getpid(), number)
    assert signals.wait(0.0) and signals.wait(0.0)


def test_a_signal_right_after_the_first_handler_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = signal.signal

    def interrupted(number: int, handler: object) -> object:
        before = plain(number, handler)  # type: ignore[arg-type]
        os.kill(os.getpid(), number)
        return before

    monkeypatch.setattr(signal, "signal", interrupted)
    waiting = EndSignals()
    monkeypatch.undo()
    try:
        assert waiting.wait(0.0)
    finally:
        waiting.close()


def test_more_than_a_pipe_holds_blocks_nobody(signals: EndSignals) -> None:
    for _ in range(70_000):
        signals.wake()
    os.kill(os.getpid(), signal.SIGTERM)
    assert signals.wait(0.0)


def test_another_thread_may_not_make_one() -> None:
    refused: list[str] = []

    def make() -> None:
        try:
            EndSignals()
        except ValueError as error:
            refused.append(str(error))

    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    assert refused == ["signals can be waited for in the main thread only"]


def test_the_wait_ends_by_itself_and_by_a_wake_but_not_by_other_signals(signals: EndSignals) -> None:
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    try:
        os.kill(os.getpid(), signal.SIGUSR1)
        began_s = time.monotonic()
        assert not signals.wait(0.3)
        assert 0.25 < time.monotonic() - began_s < 5.0
    finally:
        signal.signal(signal.SIGUSR1, before)
    other = threading.Timer(0.2, signals.wake)
    other.start()
    assert signals.wait(20.0)
    other.join()


def test_what_was_there_before_comes_back() -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    written = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(written)
    waiting = EndSignals()
    assert all(signal.getsignal(number) is not handler for number, handler in before.items())
    waiting.close()
    assert {number: signal.getsignal(number) for number in before} == before
    assert signal.set_wakeup_fd(written) == written


NODE = """
import signal, sys, threading
from rclpy.node import Node
from lime_planner.ros.runtime import run_node

class Ended(Node):
    def __init__(self):
        super().__init__("ended")
        print("serving", flush=True)
        self.create_timer(0.5, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGTERM))

sys.exit(run_node(Ended))
"""


def test_a_node_ends_by_a_signal_that_its_spinning_thread_receives() -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    from ros_harness import environment

    command = [sys.executable, "-c", NODE]
    ended = subprocess.run(command, env=environment(DOMAIN), capture_output=True, text=True, timeout=30.0, check=False)
    assert ended.returncode == 0 and "Traceback" not in ended.stderr, ended.stderr
