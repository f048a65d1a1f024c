"""Does DDS work here? Two processes of their own talk to each other, under the environment that the nodes will have.

As a program: `python -m lime_planner.ros.tools.dds_round_trip echo|ask TOPIC SECONDS`. One side asks with numbered clouds, small ones
first, then big ones; the other answers each with its number. The clouds are best effort, as many cameras publish them: those that do not
fit through the transport are lost, and counted.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

#: Points of a big cloud, 16 bytes each, and how many of them are sent, this far apart.
BIG_POINTS = 100_000
BIG_CLOUDS = 10
_PERIOD_S = 0.06
_SMALL_CLOUDS = 10


@dataclass(frozen=True)
class RoundTrip:
    """What the asking process measured.

    Attributes:
        heard: whether any answer came.
        discovery_s: from the first question to the first answer.
        small_ms: median time there and back of a small message.
        big_answered: how many of `BIG_CLOUDS` arrived.
        trouble: why a process could not even start; empty otherwise.
    """

    heard: bool = False
    discovery_s: float = 0.0
    small_ms: float = 0.0
    big_answered: int = 0
    trouble: str = ""


def measure(timeout_s: float = 10.0) -> RoundTrip:
    """Run both sides; never takes much longer than `timeout_s`."""
    topic = f"/lime_planner_doctor_{os.getpid()}"
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    commands = {role: [sys.executable, "-m", __name__, role, topic, str(timeout_s)] for role in ("echo", "ask")}
    echo = subprocess.Popen(commands["echo"], **pipes)
    ask = subprocess.Popen(commands["ask"], **pipes)
    try:
        output, errors = ask.communicate(timeout=timeout_s + 10.0)  # the start of Python and of a node is not part of the question
    except subprocess.TimeoutExpired:
        ask.kill()
        _, errors = ask.communicate()
        return RoundTrip(trouble=f"a process hung for {timeout_s + 10.0:g} s: {_last_line(errors)}")
    finally:
        echo.kill()
        _, echo_errors = echo.communicate()
    if ask.returncode != 0:
        return RoundTrip(trouble=f"a process ended with code {ask.returncode}: {_last_line(errors)}")
    found = RoundTrip(**json.loads(output.strip().splitlines()[-1]))
    if not found.heard and echo.returncode not in (0, -9):
        return RoundTrip(trouble=f"a process ended with code {echo.returncode}: {_last_line(echo_errors)}")
    return found


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it printed nothing"


def _echo(topic: str, timeout_s: float) -> None:
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import PointCloud2
    from std_msgs.msg import String

    rclpy.init(args=[])
    node = rclpy.create_node(f"{topic.strip('/')}_echo")
    answers = node.create_publisher(String, f"{topic}/answer", 50)
    node.create_subscription(
        PointCloud2, f"{topic}/question", lambda msg: answers.publish(String(data=msg.header.frame_id)), qos_profile_sensor_data
    )
    deadline = time.monotonic() + timeout_s + 10.0
    while time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)


def _ask(topic: str, timeout_s: float) -> RoundTrip:
    import rclpy
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import PointCloud2
    from std_msgs.msg import String

    rclpy.init(args=[])
    node = rclpy.create_node(f"{topic.strip('/')}_ask")
    questions = node.create_publisher(PointCloud2, f"{topic}/question", qos_profile_sensor_data)
    answered: dict[str, float] = {}
    node.create_subscription(String, f"{topic}/answer", lambda msg: answered.setdefault(msg.data, time.monotonic()), 50)

    def ask(number: str, n_points: int, wait_s: float) -> float | None:
        msg = PointCloud2(height=1, width=n_points, point_step=16, row_step=16 * n_points)
        msg.header.frame_id = number
        msg.data.frombytes(bytes(16 * n_points))
        began = time.monotonic()
        questions.publish(msg)
        while number not in answered and time.monotonic() < began + wait_s:
            rclpy.spin_once(node, timeout_sec=max(0.0, began + wait_s - time.monotonic()))
        return answered[number] - began if number in answered else None

    began, deadline, attempt = time.monotonic(), time.monotonic() + timeout_s, 0
    while not answered and time.monotonic() < deadline:
        ask(f"first {attempt}", 1, _PERIOD_S)
        attempt += 1
    if not answered:
        return RoundTrip()
    discovery_s = time.monotonic() - began
    small = [seconds for k in range(_SMALL_CLOUDS) if (seconds := ask(f"small {k}", 1, _PERIOD_S)) is not None]
    for k in range(BIG_CLOUDS):
        ask(f"big {k}", BIG_POINTS, 2.0 * _PERIOD_S)
    ask("last", 1, _PERIOD_S)
    big = sum(number.startswith("big") for number in answered)
    return RoundTrip(True, discovery_s, 1e3 * statistics.median(small or [float("nan")]), big)


def main() -> int:
    """Play one side."""
    role, topic, timeout_s = sys.argv[1], sys.argv[2], float(sys.argv[3])
    if role == "echo":
        _echo(topic, timeout_s)
    else:
        print(json.dumps(asdict(_ask(topic, timeout_s))), flush=True)
    sys.stdout.flush()
    os._exit(0)  # the answer is out: nothing of a shut-down that might hang is of interest


if __name__ == "__main__":
    sys.exit(main())
