"""The nodes as a user starts them: planner, mock arm and scene in processes of their own, the real pipeline, in a namespace."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from domains import DOMAIN
from nav_msgs.srv import GetPlan
from ros_harness import Bench, Program, code_of, execution_code, plan_id, program
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.motion.contract import violations
from lime_planner.motion.trajectory import Trajectory
from lime_planner.robot.model import Robot, home, load_robot
from lime_planner.ros import qos
from lime_planner.ros.convert import to_pose
from lime_planner.ros.inputs.clouds import encode_cloud
from lime_planner.scene.plants.generator import generate_plant
from lime_planner.scene.scene import Scene

SEED = 7
READY_S = 600.0  # with a cold kernel cache


def trajectory_of(msg: JointTrajectory) -> Trajectory:
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in msg.points]
    return Trajectory.from_samples(
        tuple(msg.joint_names), times, np.array([p.positions for p in msg.points]), np.array([p.velocities for p in msg.points])
    )


def assert_contract(robot: Robot, msg: JointTrajectory, q_measured: np.ndarray) -> None:
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec) == (0, 0)
    assert all(not point.accelerations and not point.effort for point in msg.points)
    broken = violations(
        trajectory_of(msg),
        q_measured=q_measured,
        lower=robot.lower,
        upper=robot.upper,
        velocity_limits=robot.velocity_limits,
        acceleration_limits=robot.acceleration_limits,
        joint_names=robot.joint_names,
    )
    assert not broken, broken


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("kinova_j2s6s200")


@pytest.fixture(scope="module")
def plant() -> Scene:
    return generate_plant(np.random.default_rng(SEED))


class TestTheDemoGraph:
    @pytest.fixture(scope="class")
    def bench(self, robot: Robot) -> Iterator[Bench]:
        ns = ["--ros-args", "-r", "__ns:=/left"]
        with (
            program(["-m", "lime_planner.ros.nodes.mock_arm_node", *ns], DOMAIN),
            program(["-m", "lime_planner.ros.nodes.scene_node", *ns, "-p", f"seed:={SEED}", "-p", "approach:=fixed"], DOMAIN, "publishing"),
            program(["-m", "lime_planner.ros.nodes.planner_node", *ns], DOMAIN, "serving") as planner,
        ):
            bench = Bench(robot.joint_names, home(robot), domain=DOMAIN, namespace="left", plays_arm=False)
            planner.wait_for("ready to plan", READY_S)
            bench.call("stop")
            bench.wait_inputs("joint_states", "stem_cloud", "leaf_cloud", "grasp_target")
            yield bench
            bench.close()

    def test_a_lime_is_reached_and_left_again(self, bench: Bench, robot: Robot, plant: Scene) -> None:
        before = bench.q.copy()
        response = bench.call("plan")
        assert response.success, response.message
        plan = bench.wait_phase("EXECUTING")["plan_id"]
        assert_contract(robot, bench.commands[0][1], before)
        assert bench.paths[-1].header.frame_id == "base"
        assert len(bench.paths[-1].poses) > 10

        def ended() -> list[dict[str, str]]:
            return [s for s in bench.statuses if s["plan_id"] == plan and "execution_code" in s]

        bench.wait(ended, 40.0, "the end of the motion")
        figures = ended()[-1]
        assert figures["execution_code"] == "SUCCEEDED", figures["execution_message"]
        for key in ("cost", "cost_metric", "path_length_rad", "leaf_contact_rad", "min_stem_clearance_m", "trajectory", "seed", "counts"):
            assert figures[key], key
        assert plant.target_pose is not None
        T_tool_target = np.linalg.inv(robot.forward(bench.q)) @ pose_to_matrix(plant.target_pose)
        assert np.linalg.norm(T_tool_target[:3, 3]) < 0.005
        assert np.arccos(np.clip((np.trace(T_tool_target[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)) < 0.05
        retreat = bench.call("retreat")
        assert retreat.success, retreat.message
        assert_contract(robot, bench.commands[1][1], np.array(bench.commands[0][1].points[-1].positions))
        bench.wait(lambda: np.abs(bench.q - before).max() < 0.01, 40.0, "the way back")
        assert execution_code(bench, plan_id(retreat.message)) == "SUCCEEDED"

    def test_markers_for_whoever_comes_late(self, bench: Bench, robot: Robot) -> None:
        preview = bench.call("preview")
        assert preview.success
        arrays: list[MarkerArray] = []
        watching = bench.node.create_subscription(MarkerArray, "lime_planner/markers", arrays.append, qos.LATCHED)
        bench.wait(lambda: arrays, 60.0, "markers")
        by_name = {marker.ns: marker for marker in arrays[0].markers}
        assert set(by_name) >= {"leaves", "stems", "target", "excluded_sphere", "tool_path", "goal_arm"}
        hand = np.array([[point.x, point.y, point.z] for point in by_name["goal_arm"].points])
        path = by_name["tool_path"].points
        assert np.linalg.norm(hand - [path[-1].x, path[-1].y, path[-1].z], axis=1).min() < 0.1
        assert ("touched_leaves" in by_name) is (float(bench.status_of(preview)["leaf_contact_rad"]) > 0.0)
        bench.unsubscribe(watching)

    def test_stopping_on_the_way_and_going_on_from_there(self, bench: Bench, robot: Robot) -> None:
        bench.commands.clear()
        planned = bench.call("plan")
        assert planned.success
        time.sleep(1.5)
        stopped = bench.call("stop")
        assert stopped.message.startswith("SUCCEEDED: the motion is being stopped")
        assert execution_code(bench, plan_id(planned.message)) == "CANCELLED"
        there = bench.q.copy()
        time.sleep(0.3)
        assert np.abs(bench.q - there).max() < 1e-3
        assert np.abs(there - bench.commands[0][1].points[0].positions).max() > 0.05
        preview = bench.call("preview")
        assert preview.success, preview.message
        assert len(bench.commands) == 2
        executed = bench.call("execute")
        assert executed.success
        assert_contract(robot, bench.commands[2][1], there)
        bench.call("stop")
        assert execution_code(bench, plan_id(executed.message)) == "CANCELLED"

    def test_goals_that_cannot_be(self, bench: Bench, plant: Scene) -> None:
        assert plant.target_pose is not None
        request = GetPlan.Request()
        request.goal.header.frame_id = "base"
        stem = np.median(plant.stem_points, axis=0)
        for position, code in (([3.0, 0.0, 0.5], "NO_IK_SOLUTION"), (stem, "GOAL_IN_STEM")):
            request.goal.pose = to_pose([*position, *plant.target_pose[3:]])
            bench.set(target_exclusion_radius_m=0.0)
            count = len(bench.statuses)
            response = bench.call("preview_to", request)
            assert not response.plan.poses
            assert bench.answer_since(count)["code"] == code
        bench.set(target_exclusion_radius_m=0.06)
        assert bench.call("preview").success


class TestAPlayedArm:
    """The other model behind Kinova's driver, measured several turns away, with starts that cannot be."""

    @pytest.fixture(scope="class")
    def setting(self) -> Iterator[tuple[Bench, Robot, Program]]:
        robot = load_robot("kinova_j2n6s300")
        q = home(robot) + np.where(robot.continuous, [4 * np.pi, 0, 0, -6 * np.pi, 2 * np.pi, -2 * np.pi], 0.0)
        arguments = ["-m", "lime_planner.ros.nodes.planner_node", "--ros-args", "-p", "robot:=kinova_j2n6s300", "-p", "controller:=kinova"]
        with program(arguments, DOMAIN + 1, "serving") as planner:
            bench = Bench(robot.joint_names, q, domain=DOMAIN + 1, rate_hz=10.0)
            planner.wait_for("ready to plan", READY_S)
            # A target that surely can be reached: where the tool is after a small move, among a few leaves and a stem far below.
            bench.send_target(matrix_to_pose(robot.forward(q + 0.15)))
            self.clouds(bench, np.array([[0.0, 0.0, -0.5]]))
            bench.wait_inputs()
            yield bench, robot, planner
            bench.close()

    @staticmethod
    def clouds(bench: Bench, stems: np.ndarray) -> None:
        stem, leaf = encode_cloud(stems), encode_cloud(np.array([[0.5, 0.0, -0.4], [0.5, 0.01, -0.4]]))
        stem.header.frame_id = leaf.header.frame_id = "base"
        bench.send_clouds(leaf, stem)

    def test_the_measured_turns_are_kept(self, setting: tuple[Bench, Robot, Program]) -> None:
        bench, robot, _ = setting
        before = bench.q.copy()
        response = bench.call("plan")
        assert response.success, response.message
        msg = bench.commands[-1][1]
        assert np.abs(np.array(msg.points[0].positions) - before).max() < 1e-9
        assert_contract(robot, msg, before)
        assert np.abs(np.array(msg.points[-1].positions) - before).max() < 2 * np.pi
        assert execution_code(bench, plan_id(response.message), 30.0) == "SUCCEEDED", bench.summary()
        assert bench.call("retreat").success
        bench.wait(lambda: np.abs(bench.q - before).max() < 0.01, 30.0, "the way back")

    def test_a_start_outside_the_limits(self, setting: tuple[Bench, Robot, Program]) -> None:
        bench, robot, _ = setting
        time.sleep(0.5)
        good = bench.q.copy()
        bench._motion = None
        bench.q = np.where(np.arange(robot.n) == 1, robot.upper + 0.1, good)
        time.sleep(1.0)
        count = len(bench.commands)
        message = bench.call("plan").message
        assert code_of(message) == "START_INVALID"
        assert "joint_2" in message
        bench.q = good
        time.sleep(1.0)
        assert len(bench.commands) == count
        assert bench.call("preview").success

    def test_a_start_in_a_stem(self, setting: tuple[Bench, Robot, Program]) -> None:
        bench, robot, _ = setting
        # The filter would take these points for the arm: they lie on its forearm. Without it they are a stem.
        poses = robot.link_poses(bench.q)
        forearm = next(link for link in robot.links if link.joint == 4)
        points = forearm.vertices[::7] @ poses[4, :3, :3].T + poses[4, :3, 3]
        self.clouds(bench, np.vstack([points, [[0.0, 0.0, -0.5]]]))
        time.sleep(0.5)
        preview = bench.call("preview")
        assert preview.success
        assert '"on_arm":' in bench.status_of(preview)["counts"]
        # Moved off by the filter's padding and a little more on one side only, it still stands in the hand's way of nothing; a
        # ring of points just outside the padding is what a twig through the arm looks like.
        axis = points.mean(axis=0)
        twig = axis + np.linspace(-0.15, 0.15, 200)[:, None] * np.array([[0.577, 0.577, 0.577]])
        self.clouds(bench, np.vstack([twig, [[0.0, 0.0, -0.5]]]))
        bench.set(self_filter_padding_m=0.0, stem_point_radius_m=0.02)
        time.sleep(0.5)
        message = bench.call("plan").message
        assert code_of(message) == "START_IN_STEM", message
        bench.set(self_filter_padding_m=0.01, stem_point_radius_m=0.004)
        self.clouds(bench, np.array([[0.0, 0.0, -0.5]]))
        time.sleep(0.5)
        assert bench.call("preview").success
