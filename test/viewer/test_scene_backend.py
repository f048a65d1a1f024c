"""The page's backend for files, and what it shows of a plan, without a browser."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from arm_helpers import pipeline_of, plant, robot_named, scene_of, settings

from lime_planner.cli import main as cli
from lime_planner.cli.view import _backend
from lime_planner.core.errors import ParameterError
from lime_planner.core.geometry import pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.output.animation import CHOSEN, animate
from lime_planner.output.approach_lines import APPROACH_COLOURS
from lime_planner.output.saved_plan import read_plan
from lime_planner.output.search_tree import search_tree_of
from lime_planner.output.timeline import Timeline, timeline_of
from lime_planner.pipeline import PlanResult
from lime_planner.pipeline.goals import FREE
from lime_planner.pipeline.result import PlanRecord
from lime_planner.robot.model import home
from lime_planner.viewer.backend import Activity, Moment, Wishes
from lime_planner.viewer.scene_backend import SceneBackend

QUICK = {"iterations": 400, "seed": 3}


def until(backend: SceneBackend, holds: Callable[[Moment], bool], timeout_s: float = 120.0) -> Moment:
    deadline = time.monotonic() + timeout_s
    while True:
        moment = backend.moment()
        if holds(moment):
            return moment
        assert time.monotonic() < deadline, moment.message
        time.sleep(0.01)


@pytest.fixture(scope="module")
def backend() -> Iterator[SceneBackend]:
    made = SceneBackend(robot_named, settings(**QUICK), scene=plant(15), title="plant")
    until(made, lambda moment: moment.activity is Activity.IDLE)
    yield made
    made.close()


@pytest.fixture(scope="module")
def shown() -> PlanRecord:
    scene, chosen = plant(15), settings(**QUICK)
    assert scene.target_pose is not None
    result = pipeline_of().plan(scene, pose_to_matrix(scene.target_pose), home(robot_named()), chosen)
    assert result.status is Status.SUCCEEDED
    return PlanRecord(1, scene, chosen, scene.target_pose, result)


@pytest.fixture(scope="module")
def timeline(shown: PlanRecord) -> Timeline:
    return timeline_of(pipeline_of(), shown)


def test_plan_execute_stop(backend: SceneBackend) -> None:
    backend.execute(1)
    assert "press Plan first" in backend.moment().message
    backend.plan(Wishes())
    moment = until(backend, lambda moment: moment.shown is not None and moment.activity is Activity.IDLE)
    assert moment.shown is not None and moment.shown.result.status is Status.SUCCEEDED
    assert moment.message == moment.shown.result.message and not moment.blocked_motion
    trajectory = moment.shown.result.trajectory
    assert trajectory is not None and moment.q is not None
    np.testing.assert_allclose(moment.q, home(robot_named()))
    backend.execute(moment.shown.number + 1)
    assert "a newer plan" in backend.moment().message
    backend.execute(moment.shown.number)
    moving = until(backend, lambda moment: moment.moving_s is not None and moment.moving_s > 0.5)
    assert moving.activity is Activity.MOVING and "press Stop first" in moving.blocked_plan
    backend.plan(Wishes())  # not while it moves
    backend.stop()
    rested = until(backend, lambda moment: moment.activity is Activity.IDLE)
    assert rested.message.startswith("CANCELLED") and rested.q is not None
    # The arm stopped on its path, somewhere in between.
    off = np.abs(trajectory.sample(np.linspace(0.0, trajectory.duration_s, 4000)) - rested.q).max(axis=1)
    assert off.min() < 0.01 < min(off[0], off[-1])
    assert "no longer stands where the plan begins" in rested.blocked_motion
    assert not rested.blocked_retreat
    backend.retreat()
    until(backend, lambda moment: moment.activity is Activity.MOVING)
    home_again = until(backend, lambda moment: moment.activity is Activity.IDLE)
    assert home_again.message.endswith("is back where the motion began") and home_again.shown is not None and home_again.shown.result.back
    np.testing.assert_allclose(home_again.q, home(robot_named()), atol=1e-9)
    number = home_again.shown.number
    elsewhere = home(robot_named()) + 0.05
    backend.place(elsewhere)
    assert "nothing has been executed" in backend.moment().blocked_retreat
    backend.plan(Wishes())
    again = until(backend, lambda moment: moment.shown is not None and moment.shown.number > number and moment.activity is Activity.IDLE)
    assert again.shown is not None
    np.testing.assert_allclose(again.shown.result.waypoints[0], elsewhere)


def test_wishes_count_for_one_plan(backend: SceneBackend) -> None:
    before = backend.moment()
    assert before.target is not None
    number = before.shown.number if before.shown is not None else 0
    moved = before.target + np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    backend.plan(Wishes({"leaf_weight": 5.0, "planner": "rrt_star", "iterations": 50}, moved))
    after = until(backend, lambda moment: moment.shown is not None and moment.shown.number > number and moment.activity is Activity.IDLE)
    assert after.shown is not None and after.shown.target is not None
    assert (after.shown.settings.leaf_weight, after.shown.settings.planner) == (5.0, "rrt_star")
    np.testing.assert_allclose(after.shown.target, moved)
    np.testing.assert_allclose(after.target, before.target)
    assert backend.moment().settings.planner == "lime_star"
    backend.plan(Wishes({"time_budget_s": -1.0}))
    assert "time_budget_s is -1.0; allowed" in backend.moment().message


def test_empty_backend_says_what_to_do() -> None:
    backend = SceneBackend(robot_named, settings(**QUICK))
    try:
        assert "grow a lime plant" in backend.moment().advice
        backend.plan(Wishes())
        assert "there is no scene" in backend.moment().message
        backend.open(scene_of(stems=[[0.6, 0.0, 0.3]], leaves=[[0.5, 0.0, 0.4]], frame=""), "two points")
        moment = until(backend, lambda moment: moment.robot is not None)
        assert moment.advice == "" and moment.scene is not None and moment.scene.frame_id == "base"
        assert moment.target is not None, "a scene without a target gets one to drag"
    finally:
        backend.close()


def test_foreign_frame_is_named() -> None:
    backend = SceneBackend(
        robot_named, settings(**QUICK), scene=scene_of(stems=[[0.6, 0.0, 0.3]], leaves=[[0.5, 0.0, 0.4]], frame="camera")
    )
    try:
        moment = until(backend, lambda moment: "frame" in moment.blocked_plan)
        assert "'camera'" in moment.blocked_plan and "'base'" in moment.blocked_plan
    finally:
        backend.close()


def test_timeline_agrees_with_the_plan(shown: PlanRecord, timeline: Timeline) -> None:
    figures = shown.result
    assert figures.trajectory is not None
    assert timeline.timed and timeline.duration_s == pytest.approx(figures.trajectory.duration_s)
    np.testing.assert_allclose(timeline.configurations[[0, -1]], figures.trajectory.positions[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(timeline.tool[-1], pose_to_matrix(shown.target)[:3, 3], atol=2e-3)
    assert timeline.cost[-1] == pytest.approx(figures.cost, rel=0.25)
    assert timeline.clearance_m.min() == pytest.approx(figures.min_stem_clearance_m, abs=0.004)
    assert (np.diff(timeline.cost) >= 0.0).all()
    np.testing.assert_allclose(
        timeline.configuration(0.5 * timeline.duration_s), figures.trajectory.sample(0.5 * timeline.duration_s), atol=0.01
    )


def test_touched_leaves_are_those_that_the_planner_pays_for(shown: PlanRecord, timeline: Timeline) -> None:
    agree = timeline.touched.any(axis=1) == (timeline.leaf > 0.0)
    assert agree.mean() > 0.97  # the planner thins leaves to 4 mm
    assert timeline.touched.any() and timeline.leaf_points.max() < len(shown.scene.leaf_points)


@pytest.mark.parametrize("planner", ["lime_star", "apf_rrt_star"])
def test_search_tree_begins_at_the_arm(shown: PlanRecord, planner: str) -> None:
    chosen = settings(iterations=9000 if planner == "lime_star" else 3000, planner=planner)  # paths come before the roadmap
    tree = search_tree_of(pipeline_of(), PlanRecord(1, shown.scene, chosen, shown.target, shown.result))
    assert 50 < len(tree.segments) <= tree.total and tree.segments.shape[2:] == (2, 3)
    assert len(tree.leafy) == len(tree.segments)
    start = robot_named().forward(shown.result.waypoints[0])[:3, 3]
    assert np.linalg.norm(tree.segments.reshape(-1, 3) - start, axis=1).min() < 1e-5


def test_saved_plan_comes_back(tmp_path: Path, shown: PlanRecord, capsys: pytest.CaptureFixture[str]) -> None:
    scene, plan, gif = tmp_path / "plant.npz", tmp_path / "plan.json", tmp_path / "reach.gif"
    shown.scene.save(scene)
    assert cli.main(["plan", str(scene), "--json", str(plan), "--iterations", "400", "--seed", "3", "--set", "stem_margin_m=0.006"]) == 0
    saved = read_plan(plan)
    assert saved.parameters == {"stem_margin_m": 0.006, "iterations": 400, "seed": 3}
    result = saved.result(robot_named())
    assert result.status is Status.SUCCEEDED and result.trajectory is not None
    assert json.loads(plan.read_text())["trajectory"]["positions"] == result.trajectory.positions.tolist()
    assert len(result.approaches) == result.grasps_tried >= 600 and int((result.approach_outcomes == FREE).sum()) == result.grasps_free
    np.testing.assert_allclose(result.approaches[:, :3] - result.target.centre, 0.0, atol=1e-4)  # type: ignore[union-attr]
    assert saved.load_scene().n_points == shown.scene.n_points
    backend = SceneBackend(
        robot_named, settings(), scene=saved.load_scene(), target=saved.target, q_start=saved.q_start, saved=saved.result
    )
    try:
        moment = until(backend, lambda moment: moment.shown is not None)
        assert moment.shown is not None and not moment.blocked_motion
        np.testing.assert_allclose(moment.shown.result.waypoints, result.waypoints)
    finally:
        backend.close()
    assert cli.main(["animate", str(plan), "--out", str(gif), "--fps", "2", "--width", "160"]) == 0
    from PIL import Image

    with Image.open(gif) as picture:
        assert picture.width == 160
        assert picture.n_frames == 2 + round(result.trajectory.duration_s * 2.0) + 1
        frames = [np.asarray(picture.convert("RGB")).astype(int) for number in range(3) if picture.seek(number) is None]
    # First the approaches that were tried, green where they are free, then the chosen one in blue, then the motion.
    green, blue = (np.round(255.0 * np.array(colour)) for colour in (APPROACH_COLOURS[FREE], CHOSEN))
    near = [[int((np.abs(frame[44:] - colour).max(axis=2) < 12).sum()) for colour in (green, blue)] for frame in frames]
    assert near[0][0] > near[1][0] and near[1][1] > near[2][1] and near[1][1] > near[0][1]
    assert cli.main(["animate", str(plan), "--out", str(tmp_path / "reach.avi")]) == 1
    assert "ends in none of .gif, .mp4" in capsys.readouterr().err


def test_a_plan_saved_in_python_comes_back(tmp_path: Path, shown: PlanRecord, capsys: pytest.CaptureFixture[str]) -> None:
    scene, gif = tmp_path / "plant.npz", tmp_path / "reach.gif"
    shown.scene.save(scene)
    bare, named = shown.result.save(tmp_path / "bare.json"), shown.result.save(tmp_path / "named.json", scene_path="plant.npz")

    def drawn(plan: Path, *options: str) -> int:
        return cli.main(["animate", str(plan), "--out", str(gif), "--fps", "1", "--width", "120", *options])

    assert drawn(named) == 0 and gif.stat().st_size > 1000
    gif.unlink()
    assert drawn(bare) == 1
    assert "bare.json: does not name its scene; give it with --scene SCENE" in capsys.readouterr().err
    assert drawn(bare, "--scene", str(scene)) == 0 and gif.stat().st_size > 1000
    backend = _backend(cli.build_parser(["view"]).parse_args(["view", str(bare), "--scene", str(scene)]))
    try:
        moment = until(backend, lambda moment: moment.shown is not None)
        assert moment.shown is not None and moment.scene is not None and moment.scene.n_points == shown.scene.n_points
        np.testing.assert_allclose(moment.shown.result.waypoints, shown.result.waypoints)
        np.testing.assert_allclose(moment.target, shown.target)
        assert (moment.settings.iterations, moment.settings.seed) == (400, 3)
    finally:
        backend.close()
    scene.unlink()
    assert drawn(named) == 1
    assert "its scene plant.npz is not there; say where it is with --scene" in capsys.readouterr().err
    own = read_plan(shown.result.save(tmp_path / "own.json", robot_path="arm.urdf"))
    assert own.parameters["robot"] == "arm.urdf"
    assert cli.main(["view", str(scene), "--scene", str(scene)]) == 1
    assert "--scene is for a saved plan" in capsys.readouterr().err


def test_a_refused_plan_comes_back_too(tmp_path: Path, shown: PlanRecord, capsys: pytest.CaptureFixture[str]) -> None:
    shown.scene.save(tmp_path / "plant.npz")
    start = home(robot_named()) + 0.1
    refused = PlanResult(Status.NO_PATH, "NO_PATH: none", "lime_star", 1, T_base_tool=shown.result.T_base_tool, q_start=start)
    plan = refused.save(tmp_path / "refused.json", scene_path="plant.npz")
    again = read_plan(plan).result(robot_named())
    assert again.status is Status.NO_PATH and again.waypoints.shape == (0, 6)
    assert again.q_start == pytest.approx(start) and again.T_base_tool == pytest.approx(shown.result.T_base_tool)
    assert cli.main(["animate", str(plan), "--out", str(tmp_path / "a.gif")]) == 1
    assert capsys.readouterr().err.startswith("BAD_INPUT: the plan has no path to animate: NO_PATH: none")


def test_video(tmp_path: Path, shown: PlanRecord) -> None:
    import imageio

    path = animate(tmp_path / "reach.mp4", pipeline_of(), shown, fps=1.0, width=160)
    with imageio.get_reader(path) as reader:
        frames = [frame for frame in reader]
    assert shown.result.trajectory is not None and len(frames) > shown.result.trajectory.duration_s
    assert np.ptp(np.asarray(frames[0], dtype=int)) > 100


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("{", "cannot be read as a plan"),
        ("[]", "is no plan"),
        ('{"status": "SUCCEEDED"}', "it lacks message"),
        (None, "cannot be read as a plan"),
    ],
)
def test_what_is_no_plan(tmp_path: Path, content: str | None, sentence: str) -> None:
    path = tmp_path / "plan.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ParameterError, match=sentence):
        read_plan(path)
