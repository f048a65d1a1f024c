"""`lime-planner view --nodes`: scene, simulated arm and planner as the demo starts them, and the planner's own page."""

from __future__ import annotations

import argparse
import importlib.util
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import PARAMETERS, settings_from
from lime_planner.ros.demo.demo import DEFAULT_SEED, Clock, choose_arm, completed_scene, label_field, scene_of
from lime_planner.ros.demo.processes import Corner, DemoError, Processes
from lime_planner.viewer.access import Access
from lime_planner.viewer.serving import DEFAULT_PORT, announce, free_port, until_signal

_FOLDER = Path("out")  # as the demo's
_START_TIMEOUT_S = 60.0
_CHECK_PERIOD_S = 0.5


def run_with_nodes(args: argparse.Namespace, access: Access, given: Mapping[str, Any]) -> int:
    """Start the nodes, say where the page is, and end them at Ctrl-C; 0 then.

    Args:
        args: of `lime-planner view`.
        access: to the page.
        given: the planner's parameters, by name.

    Raises:
        DemoError: a node has ended, or the page does not come.
        ParameterError: parameters that mean nothing here.
    """
    if args.start is not None:
        raise ParameterError("--start: with --nodes the arm starts where the simulated arm stands")
    values, clock = dict(given), Clock()
    field = label_field(args, values)
    choose_arm(values, clock)
    planning = {name: value for name, value in values.items() if name in PARAMETERS}
    settings = settings_from(planning)
    if settings.robot == "topic":
        raise ParameterError("robot: --nodes needs a built-in model or a URDF file")
    if importlib.util.find_spec("rclpy") is None:
        raise ModuleNotFoundError("the nodes need ROS 2", name="rclpy")
    from lime_planner.ros.display.viewer_backend import TOKEN_VARIABLE
    from lime_planner.ros.model_loader import build

    port = free_port(access.host, DEFAULT_PORT if args.port is None else args.port, tries=1 if args.port else 20)
    clock.say("reading the scene" if args.what else "growing a lime plant")
    scene = scene_of(argparse.Namespace(**{**vars(args), "scene": args.what, "plant_seed": DEFAULT_SEED}), field)
    os.environ[TOKEN_VARIABLE] = access.token  # of the node; a parameter could be read by everybody in the ROS graph
    corner, arm = Corner.own(), {"robot": settings.robot}
    with until_signal() as signals, Processes(corner, _FOLDER / "logs") as nodes:
        clock.say(f"starting planner_node and mock_arm_node in ROS domain {corner.domain}, namespace {corner.namespace}")
        # A browser that draws without a graphics card takes the processor from the simulated arm now and then.
        given = {**arm, "max_joint_state_age_s": 1.0, **values, "viewer_port": port, "viewer_host": access.host}
        nodes.start("planner_node", "lime_planner.ros.nodes.planner_node", given)
        nodes.start("mock_arm_node", "lime_planner.ros.nodes.mock_arm_node", arm)
        scene = completed_scene(scene, build(settings, None), planning, clock)
        scene.save(_FOLDER / "scene.npz")
        clock.say("starting scene_node")
        nodes.start("scene_node", "lime_planner.ros.nodes.scene_node", {"file": str((_FOLDER / "scene.npz").resolve()), "labelled": True})
        _wait_for_page(access.host, port, nodes)
        announce(access.url(port), access, open_browser=not args.no_browser)
        while not signals.wait(_CHECK_PERIOD_S):
            nodes.check()
    return 0


def _wait_for_page(host: str, port: int, nodes: Processes) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    while True:
        nodes.check()
        try:
            socket.create_connection((host, port), 1.0).close()
            return
        except OSError:
            if time.monotonic() > deadline:
                raise DemoError(f"the planner's page did not come up at port {port} within {_START_TIMEOUT_S:g} s") from None
            time.sleep(0.1)
