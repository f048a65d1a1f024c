"""The demo as a stranger runs it: real processes, a real plan, and nothing left behind."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="the demo needs ROS 2 (extra `ros`, or a sourced installation)")

from lime_planner.core.errors import ParameterError
from lime_planner.ros.demo.processes import Corner, DemoError, Processes, ros_value

ROOT = Path(__file__).resolve().parents[3]
#: Compiling everything in an empty cache takes minutes on two slow cores; with a warm one the demo takes 20 s.
TIMEOUT_S = 420.0


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "lime_planner", "demo", *arguments]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def nodes_of(namespace: str) -> list[str]:
    """Command lines of the processes in a demo's namespace."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = entry.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if f"__ns:={namespace}" in command:
            found.append(command)
    return found


def test_demo_reaches_the_target_and_leaves_nothing_behind(tmp_path: Path) -> None:
    process = start("--out", str(tmp_path / "out"))
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0, out + err
    assert err == ""
    assert "SUCCEEDED: the arm reached the target" in out.splitlines()[-1]
    table = out[out.index("Reach to a target") :].split("\n\n")[0]
    assert max(map(len, table.splitlines())) <= 80
    for words in ("free approach", "fixed pose", "leaves solid", "leaves ignored", "goal error,", "measured [mm]"):
        assert words in table
    assert (tmp_path / "out" / "demo.png").stat().st_size > 50_000
    figures = json.loads((tmp_path / "out" / "demo.json").read_text())
    assert figures["driven"]["status"] == figures["driven"]["execution_code"] == "SUCCEEDED"
    assert figures["driven"]["leaf_contact_rad"] <= figures["leaves_ignored"]["leaf_contact_rad"] + 0.05
    assert "look 1: " in out and 1 <= figures["driven"]["looks"] <= 2 and figures["driven"]["views"] > 2
    [namespace] = set(re.findall(r"/lime_demo_\d+", out))
    assert nodes_of(namespace) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=lambda n: n.name)
def test_nodes_end_with_the_demo(tmp_path: Path, number: signal.Signals) -> None:
    process = start("--out", str(tmp_path))
    assert process.stdout is not None
    namespace = ""
    for line in process.stdout:
        if "namespace" in line:
            [namespace] = re.findall(r"/lime_demo_\d+", line)
            break
    deadline = time.monotonic() + 20.0
    while len(nodes_of(namespace)) < 3 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(nodes_of(namespace)) == 3
    os.kill(process.pid, number)
    _, err = process.communicate(timeout=30.0)
    if number is not signal.SIGKILL:
        assert process.returncode == 130
        assert err == "CANCELLED: stopped by the keyboard\n"
    deadline = time.monotonic() + 15.0
    while nodes_of(namespace) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert nodes_of(namespace) == []


def test_scene_that_is_missing(tmp_path: Path) -> None:
    process = start("--scene", str(tmp_path / "none.npz"), "--out", str(tmp_path / "out"))
    _, err = process.communicate(timeout=60.0)
    assert process.returncode == 1
    assert err.startswith("BAD_INPUT: ") and err.count("\n") == 1


def test_a_node_that_ends_is_noticed(tmp_path: Path) -> None:
    with Processes(Corner.own(), tmp_path) as nodes:
        nodes.start("scene_node", "lime_planner.ros.nodes.scene_node", {"file": str(tmp_path / "none.npz")})
        with pytest.raises(DemoError, match=r"scene_node ended with code 2: .*there is no such file"):
            for _ in range(400):
                nodes.check()
                time.sleep(0.05)


def test_corner_belongs_to_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "207")
    assert Corner.own().domain == 207
    monkeypatch.setenv("ROS_DOMAIN_ID", "233")
    with pytest.raises(ParameterError, match="ROS_DOMAIN_ID is '233'"):
        Corner.own()
    monkeypatch.delenv("ROS_DOMAIN_ID")
    corner = Corner.own()
    assert 1 <= corner.domain <= 101
    assert str(os.getpid()) in corner.namespace
    assert corner.environment()["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


@pytest.mark.parametrize(
    ("value", "text"),
    [(True, "true"), (2.0, "2.0"), (1e-05, "1e-05"), (3, "3"), ("base", '"base"'), ('a"b', '"a\\"b"'), ([0.5, 1.0], "[0.5, 1.0]")],
)
def test_parameters_keep_their_types(value: object, text: str) -> None:
    assert ros_value(value) == text
