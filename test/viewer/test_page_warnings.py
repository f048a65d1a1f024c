"""What the page says at once about a scene that is hardly meant, and that its figures, advice and lights tell one story."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest
from arm_helpers import pipeline_of, plant, robot_named, scene_of, settings

from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.status import Status
from lime_planner.output import timeline
from lime_planner.output.picture import link_mesh
from lime_planner.pipeline.plausibility import doubts_about
from lime_planner.pipeline.result import PlanRecord, PlanResult
from lime_planner.pipeline.targets import pose_target
from lime_planner.robot.model import home
from lime_planner.scene.scene import Scene
from lime_planner.viewer import words
from lime_planner.viewer.backend import Activity, Moment, Wishes
from lime_planner.viewer.scene_backend import SceneBackend


def millimetres() -> Scene:
    scene = plant(15)
    points = np.concatenate([scene.leaf_points, scene.stem_points]) * 1000.0
    return Scene.from_points(points, np.r_[np.zeros(len(scene.leaf_points), int), np.ones(len(scene.stem_points), int)])


def idle(backend: SceneBackend) -> Moment:
    deadline = time.monotonic() + 120.0
    while backend.moment().activity is not Activity.IDLE:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return backend.moment()


def test_a_scene_in_millimetres_is_warned_of_before_any_plan() -> None:
    robot = robot_named()
    backend = SceneBackend(robot_named, settings(iterations=100, seed=3), scene=millimetres(), title="mm.npz")
    try:
        moment = idle(backend)
        assert moment.target is not None and np.linalg.norm(moment.target[:3]) < robot.reach_m, "the marker is where the arm can get"
        assert "the scene has no target" in moment.message
        assert moment.doubts == doubts_about(millimetres(), robot, moment.target[:3], home(robot)) and "millimetres" in moment.doubts[0]
        said = words.status(moment, "", moment.doubts, [])
        assert said.count('class="warning"') == 1 and "millimetres" in said and "Warning:" in said
        backend.open(plant(15), "plant")
        assert backend.moment().doubts == () and "press Plan" in backend.moment().message
        backend.open(millimetres(), "mm.npz")
        assert "millimetres" in backend.moment().doubts[0]
        backend.open(plant(15), "plant")
        backend.plan(Wishes())
        planning = backend.moment()
        assert "press Plan" not in words.status(planning, "", (), []) and "searching for a path" in planning.message
        backend.stop()
    finally:
        backend.close()


def test_leaves_that_cost_are_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = robot_named()
    begin, end = home(robot), home(robot) + np.array([0.8, 0.0, 0.0, 0.0, 0.0, 0.0])
    vertices, _ = link_mesh(robot, 0.5 * (begin + end), [robot.links[-1].name])
    scene = scene_of(stems=[[2.0, 2.0, 2.0]], leaves=vertices[:1])
    aim = pose_target(matrix_to_pose(robot.forward(end)))
    result = PlanResult(Status.NO_PATH, "NO_PATH: none", "lime_star", 1, waypoints=np.array([begin, end]), target=None, q_start=begin)
    monkeypatch.setattr(timeline, "_STEP_RAD", 10.0)  # the leaf lies between two samples
    made = timeline.timeline_of(pipeline_of(), PlanRecord(1, scene, settings(), None, dataclasses.replace(result, target=aim)))
    assert made.leaf_contact_rad > 0.0 and list(made.leaf_points) == [0] and made.touched.any(axis=1).sum() == 1
