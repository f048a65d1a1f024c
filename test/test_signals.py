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
from ros_harness import Program

from lime_planner.signals import EndSignals


@pytest.fixture
def signals() -> Iterator[EndSignals]:
    waiting = EndSignals()
    yield waiting
    waiting.close()


def _later(call: object, *arguments: object) -> threading.Thread:
    def run() -> None:
        time.sleep(0.2)
        call(*arguments)  # type: ignore[operator]

    thread = threading.Thread(target=run)
    thread.start()
    return thread


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_another_thread_receives_ends_the_wait(signals: EndSignals, number: int) -> None:
    thread = _later(lambda: signal.pthread_kill(threading.get_ident(), number))
    assert signals.wait(20.0)
    thread.join()


def test_a_signal_before_the_wait_counts_and_many_do_not_block(signals: EndSignals) -> None:
    for _ in range(70_000):  # more than a pipe holds
        signals.wake()
    os.kill(os.getpid(), signal.SIGTERM)
    assert signals.wait(0.0)


def test_the_wait_ends_by_itself_and_by_a_wake_but_not_by_other_signals(signals: EndSignals) -> None:
    before = signal.signal(signal.SIGUSR1, lambda *_: None)
    try:
        os.kill(os.getpid(), signal.SIGUSR1)
        began_s = time.monotonic()
        assert not signals.wait(0.3)
        assert 0.25 < time.monotonic() - began_s < 5.0
    finally:
        signal.signal(signal.SIGUSR1, before)
    thread = _later(signals.wake)
    assert signals.wait(20.0)
    thread.join()


def test_what_was_there_before_comes_back() -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    waiting = EndSignals()
    assert all(signal.getsignal(number) is not handler for number, handler in before.items())
    waiting.close()
    assert {number: signal.getsignal(number) for number in before} == before
    assert signal.set_wakeup_fd(-1) == -1


NODE = """
import signal, sys, threading
from rclpy.node import Node
from lime_planner.ros.runner import run_node

class Ended(Node):
    def __init__(self):
        super().__init__("ended")
        print("serving", flush=True)
        self.create_timer(0.5, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGTERM))

sys.exit(run_node(Ended))
"""


@pytest.mark.alone
def test_a_node_ends_by_a_signal_that_its_spinning_thread_receives() -> None:
    node = Program(["-c", NODE], 60 + os.getpid() % 40)
    try:
        assert node.process.wait(20.0) == 0, node.output
    except subprocess.TimeoutExpired:
        node.process.kill()
        raise AssertionError(f"the signal is lost: {node.output}") from None
    assert sys.platform != "linux" or "Traceback" not in node.output
