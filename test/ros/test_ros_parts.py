"""Model loader, way back, markers, throttle, arm filter and the arm's surface."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from ros_fakes import FakePipeline, FakeRobot, result

from lime_planner.collision.arm_filter import FAR_M, ArmSurface, make_arm_filter
from lime_planner.core.errors import Refusal, RobotError
from lime_planner.core.parameters import settings_from
from lime_planner.core.status import Status
from lime_planner.motion.way_back import way_back
from lime_planner.pipeline.result import PlanRecord
from lime_planner.robot.model import Robot, home, load_robot
from lime_planner.ros.display.markers import markers
from lime_planner.ros.execution.retreat import Path, WayOut, nearest_turns
from lime_planner.ros.model_loader import Loaded, ModelLoader
from lime_planner.ros.runtime import Severity, Throttle
from lime_planner.scene.scene import Scene

pytestmark = pytest.mark.timed


def never() -> bool:
    return False


class Log:
    """Records what a model loader says and which models it brought."""

    def __init__(self) -> None:
        self.reports: list[tuple[Severity, str]] = []
        self.models: list[Loaded] = []
        self.may_exchange = True

    def loader(self, builder: Any, robot: str = "kinova_j2s6s200") -> ModelLoader:
        settings = settings_from({"robot": robot})
        return ModelLoader(
            builder,
            settings,
            may_exchange=lambda: self.may_exchange,
            on_loaded=self.models.append,
            report=lambda severity, sentence: self.reports.append((severity, sentence)),
        )


def build(_settings: Any, urdf: str | None, warm_up_s: float = 0.0) -> Loaded:
    if urdf == "bad":
        raise RobotError("the URDF has no joints")
    return Loaded(FakeRobot(name=urdf or "fake"), FakePipeline(FakeRobot(), warm_up_s))


def refusal_of(loader: ModelLoader, timeout_s: float) -> tuple[Status, str]:
    with pytest.raises(Refusal) as caught, loader.use(timeout_s, never):
        pass
    return caught.value.status, str(caught.value)


def test_requests_wait_for_the_warm_up_within_their_bound() -> None:
    log = Log()
    loader = log.loader(lambda settings, urdf: build(settings, urdf, 0.3))
    assert loader.wait_loaded(1.0, never).robot.name == "fake"
    status, sentence = refusal_of(loader, 0.05)
    assert status is Status.NOT_READY
    assert "compiling the kernels; waited 0.05 s" in sentence
    assert log.models
    with loader.use(60.0, never) as loaded:  # the first stop is compiled too
        assert loaded.robot.name == "fake"
    assert loader.ready
    assert "ready to plan for fake" in log.reports[0][1]
    assert loader.close()


def test_a_robot_that_cannot_be_loaded_is_a_sentence() -> None:
    log = Log()
    loader = log.loader(lambda settings, urdf: build(settings, "bad"))
    status, sentence = refusal_of(loader, 60.0)
    assert (status, sentence) == (Status.BAD_INPUT, "the robot cannot be loaded: the URDF has no joints")
    assert log.reports == [(Severity.ERROR, sentence)]

    def defect(_settings: Any, _urdf: str | None) -> Loaded:
        raise ZeroDivisionError("oops")

    assert "ZeroDivisionError: oops" in refusal_of(log.loader(defect), 5.0)[1]


def test_descriptions_are_taken_in_between_plans_only() -> None:
    log = Log()
    loader = log.loader(build, "topic")
    assert refusal_of(loader, 0.05)[1].startswith("waiting for robot_description")
    loader.offer("bad")
    assert refusal_of(loader, 60.0)[0] is Status.BAD_INPUT
    loader.offer("one")
    with loader.use(60.0, never) as loaded:
        assert loaded.robot.name == "one"
        loader.offer("two")
        time.sleep(0.1)
        assert [model.robot.name for model in log.models] == ["one"]
    deadline = time.monotonic() + 60.0
    while len(log.models) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    with loader.use(60.0, never) as loaded:
        assert loaded.robot.name == "two"
    log.may_exchange = False
    loader.offer("three")
    time.sleep(0.15)
    with loader.use(60.0, never) as loaded:
        assert loaded.robot.name == "two"
    loader.offer("bad")
    assert loader.close()


def test_the_same_description_again_changes_nothing() -> None:
    log = Log()
    loader = log.loader(build, "topic")

    def taken(count: int) -> None:
        deadline = time.monotonic() + 60.0
        while len(log.models) < count and time.monotonic() < deadline:
            time.sleep(0.01)
        with loader.use(60.0, never):
            assert [model.robot.name for model in log.models] == ["one", "two", "one"][:count]

    loader.offer("one")
    taken(1)
    for _ in range(3):  # the publisher was restarted
        loader.offer("one")
    time.sleep(0.2)
    taken(1)
    loader.offer("two")
    taken(2)
    loader.offer("one")
    taken(3)
    assert loader.close()


def test_a_description_that_failed_may_be_offered_again() -> None:
    log = Log()
    there = []

    def builder(settings: Any, urdf: str | None) -> Loaded:
        return build(settings, urdf if there else "bad")

    loader = log.loader(builder, "topic")
    loader.offer("one")
    assert refusal_of(loader, 60.0)[0] is Status.BAD_INPUT
    there.append("its meshes")
    loader.offer("one")
    with loader.use(60.0, never) as loaded:
        assert loaded.robot.name == "one"
    assert loader.close()


def test_a_bad_description_leaves_the_good_model() -> None:
    log = Log()
    loader = log.loader(build, "topic")
    loader.offer("one")
    with loader.use(60.0, never):
        pass
    loader.offer("bad")
    deadline = time.monotonic() + 60.0
    while not (log.reports and log.reports[-1][0]) and time.monotonic() < deadline:
        time.sleep(0.01)
    with loader.use(1.0, never) as loaded:
        assert loaded.robot.name == "one"
    assert loader.close()


PATH = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])


def test_the_way_back_leads_over_the_same_waypoints() -> None:
    assert way_back(PATH, [1.0, 1.0]).tolist() == [[1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]
    assert way_back(PATH, [1.0, 0.4]).tolist() == [[1.0, 0.4], [1.0, 0.0], [0.0, 0.0]]
    assert way_back(PATH, [0.5, 0.01]).tolist() == [[0.5, 0.01], [0.0, 0.0]]


def gone(*paths: list[list[float]]) -> WayOut:
    way = WayOut()
    for path in paths:
        way.went(Path(np.array(path)), [False, False])
    return way


def out_of(way: WayOut, q: list[float]) -> list[list[float]]:
    assert way.path is not None
    return way_back(nearest_turns(way.path.waypoints, q, [False, False]), q).tolist()


def test_the_way_out_is_that_of_the_last_real_motions() -> None:
    there = PATH.tolist()
    assert out_of(gone(there), [1.0, 1.0]) == [[1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]
    correction = [[1.0, 1.0], [1.02, 1.03]]
    assert out_of(gone(there, correction), [1.02, 1.03]) == [[1.02, 1.03], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]
    again = [[1.02, 1.03], [1.0, 1.0]]
    assert out_of(gone(there, correction, again), [1.0, 1.0])[-1] == [0.0, 0.0]
    onwards = [[1.0, 1.0], [2.0, 1.0]]
    assert out_of(gone(there, onwards), [2.0, 1.0]) == [[2.0, 1.0], [1.0, 1.0]], "a real motion from where the last one ended"
    corrected_on_the_way = [[1.0, 0.3], [1.03, 0.3]]
    assert out_of(gone(there, corrected_on_the_way), [1.03, 0.3]) == [[1.03, 0.3], [1.0, 0.3], [1.0, 0.0], [0.0, 0.0]]
    back_at_the_beginning = [[0.001, 0.0], [0.0, 1.0]]
    assert out_of(gone(there, back_at_the_beginning), [0.0, 1.0])[-1] == [0.001, 0.0]
    led_by_hand = [[3.0, 3.0], [3.02, 3.0]]
    assert out_of(gone(there, led_by_hand), [3.02, 3.0]) == [[3.02, 3.0], [3.0, 3.0]]


def test_the_way_out_is_found_across_a_turn() -> None:
    way = WayOut()
    way.went(Path(np.array([[3.0, 0.0], [3.3, 1.0]])), [True, False])
    turn = 2.0 * np.pi
    way.went(Path(np.array([[3.3 - turn, 1.0], [3.32 - turn, 1.0]])), [True, False])
    assert way.path is not None
    assert way.path.waypoints == pytest.approx(np.array([[3.0 - turn, 0.0], [3.3 - turn, 1.0], [3.32 - turn, 1.0]]))


def test_the_way_back_must_be_known() -> None:
    with pytest.raises(Refusal) as caught:
        way_back(PATH, [0.3, 0.5])
    assert caught.value.status is Status.START_INVALID
    assert "0.500 rad" in str(caught.value)
    for arrived in (PATH[0], PATH[0] + 0.005):
        with pytest.raises(Refusal) as caught:
            way_back(PATH, arrived)
        assert caught.value.status is Status.NOTHING_TO_EXECUTE


def test_markers_show_what_was_used() -> None:
    scene = Scene(np.ones((30_000, 3)), np.ones(30_000), np.ones((5, 3)), np.empty((0, 3)))
    settings = settings_from({"keep_out_boxes": [0.0, 0.0, 0.0, 1.0, 2.0, 3.0]})
    plan = result(np.zeros(3), np.ones(3))
    plan.tool_leaf[3] = 0.5
    array = markers(PlanRecord(1, scene, settings, np.eye(7)[6], plan), Time())  # type: ignore[arg-type]
    by_name = {marker.ns: marker for marker in array.markers}
    assert set(by_name) == {"", "leaves", "stems", "keep_out_boxes", "target", "excluded_sphere", "tool_path"}
    assert len(by_name["leaves"].points) <= 10_000
    assert len(by_name["stems"].points) == 5
    assert by_name["keep_out_boxes"].scale.z == 3.0
    colours = [colour.r for colour in by_name["tool_path"].colors]
    assert [round(red, 2) for red in colours] == [0.1, 0.1, 0.1, 0.9, 0.1]
    assert len({marker.id for marker in array.markers}) == len(array.markers)


def test_repeated_warnings_are_held_back_by_kind() -> None:
    said: list[str] = []
    throttle = Throttle(said.append, 0.1)
    for k in range(5):
        throttle(f"leaf_cloud is {k}.0 s old")
    throttle("stem_cloud has no field 'x'")
    time.sleep(0.12)
    throttle("leaf_cloud is 9.0 s old")
    assert said == [
        "leaf_cloud is 0.0 s old",
        "stem_cloud has no field 'x'",
        "leaf_cloud is 9.0 s old (4 more like this since the last)",
    ]


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot("kinova_j2s6s200")


def surface_points(arm: Robot, q: np.ndarray, outward_m: float) -> np.ndarray:
    """Points off the centres of the meshes' triangles, along the normals."""
    poses, found = arm.link_poses(q), []
    for link in arm.links:
        corners = link.vertices[link.triangles[::97]] @ poses[link.joint, :3, :3].T + poses[link.joint, :3, 3]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        found.append((corners.mean(axis=1) + outward_m * normals / np.maximum(lengths, 1e-12))[lengths[:, 0] > 1e-9])
    return np.concatenate(found)


def test_distances_to_the_arms_own_surface(arm: Robot) -> None:
    q = home(arm) + np.array([0.3, -0.2, 0.1, 4.0, -0.5, 7.0])
    surface = ArmSurface(arm)
    assert np.abs(surface.distance(surface_points(arm, q, 0.0), q)).max() < 1e-5
    near = surface.distance(surface_points(arm, q, 0.004), q)
    assert (np.abs(near) <= 0.004 + 1e-5).all()
    far = surface.distance(np.array([[3.0, 3.0, 3.0], [0.0, 0.0, -5.0]]), q)
    assert far.tolist() == [FAR_M, FAR_M]


def test_the_arm_is_removed_and_a_stem_beside_it_survives(arm: Robot) -> None:
    q = home(arm)
    surface = ArmSurface(arm)
    on_arm = surface_points(arm, q, 0.003)
    candidates = surface_points(arm, q, 0.015)
    stem = candidates[np.abs(surface.distance(candidates, q) - 0.015) < 1e-4].astype(np.float32)
    assert len(stem) > 100
    points = np.concatenate([on_arm, stem])
    scene = Scene(on_arm, np.ones(len(on_arm)), points, np.empty((0, 3)))
    arm_filter = make_arm_filter(arm)
    kept = arm_filter(scene, q, 0.01)
    assert np.array_equal(kept.stem_points, stem)
    assert len(kept.leaf_points) == 0
    assert kept.counts["on_arm"] + kept.counts["outliers"] == 2 * len(on_arm)
    unknown = arm_filter(scene, None, 0.01)
    assert np.array_equal(unknown.stem_points, scene.stem_points), "a stem is never an outlier"
    assert unknown.counts["arm_not_removed"] == unknown.n_points


def test_the_filter_serves_two_threads(arm: Robot) -> None:
    arm_filter, q = make_arm_filter(arm), home(arm)
    scene = Scene(np.empty((0, 3)), np.empty(0), surface_points(arm, q, 0.0), np.empty((0, 3)))
    left: list[int] = []
    threads = [threading.Thread(target=lambda: left.append(arm_filter(scene, q, 0.01).n_points)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert left == [0, 0]
