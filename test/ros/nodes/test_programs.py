"""The nodes' programs from the command line: help, what means nothing to them, and a signal while they still import."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time

import pytest
from domains import DOMAIN
from ros_harness import ROOT, environment

pytestmark = pytest.mark.timed

PROGRAMS = ("planner_node", "scene_node", "mock_arm_node")


def start(name: str, *arguments: str) -> subprocess.Popen[str]:
    """One of the console scripts, which says when its code is reached."""
    code = f"import sys; from lime_planner.ros.programs import {name} as run; print('on', flush=True); sys.exit(run())"
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.Popen(command, cwd=ROOT, env=environment(DOMAIN), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("name", PROGRAMS)
def test_help_names_topics_and_how_parameters_are_set(name: str) -> None:
    running = start(name, "--help", "--ros-args", "-p", "seed:=3")
    out, err = running.communicate(timeout=60.0)
    assert running.returncode == 0 and not err, err
    wanted = {
        "planner_node": ["stem_cloud", "labelled_cloud", "grasp_target", "joint_trajectory", "~/preview_to", "~/stop", "/diagnostics"],
        "scene_node": ["leaf_cloud", "labelled_cloud", "rate_hz", "density"],
        "mock_arm_node": ["joint_trajectory", "joint_states", "controller", "speed_scaling", "report_wrapped"],
    }[name]
    wanted += [f"usage: {name}", "--ros-args -p", "--params-file", "__ns:=/left", "--log-level", f"ros2 run lime_planner {name}"]
    assert [words for words in wanted if words not in out] == []
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize("name", PROGRAMS)
def test_an_argument_that_means_nothing_is_told(name: str) -> None:
    running = start(name, "seed:=3")
    _, err = running.communicate(timeout=60.0)
    assert running.returncode == 2
    assert re.fullmatch(rf"{name}: 'seed:=3' means nothing to it; .*--ros-args -p seed:=3.*\n", err), err


def test_a_signal_while_the_program_imports_leaves_no_traceback() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        for delay_s in (0.05, 0.2, 0.5, 1.0, 1.5):
            running = start("planner_node")
            assert running.stdout is not None and running.stdout.readline() == "on\n"
            time.sleep(delay_s)
            running.send_signal(number)
            out, err = running.communicate(timeout=60.0)
            assert running.returncode == 0, (number, delay_s, out, err)
            assert "Traceback" not in err and "KeyboardInterrupt" not in err, err
