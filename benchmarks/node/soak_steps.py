"""The steps of the soak test: what a user, a camera and a broken arm do to the planner, and what it must answer."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import Counter
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, PointStamped, PoseArray
from nav_msgs.srv import GetPlan
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_fakes import cloud
from ros_harness import Bench, code_of
from sensor_msgs.msg import JointState

from benchmarks.node.soak_cases import ANSWER_S, ARRIVED_RAD, BAD_SETTINGS, CALM, FAULTS, SCENE, SETTINGS, STEM_STOP_S
from benchmarks.node.soak_checks import EXCLUSION_M, Judge
from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.status import Status
from lime_planner.robot.model import Robot
from lime_planner.ros import qos
from lime_planner.ros.convert import to_pose
from lime_planner.ros.inputs.clouds import encode_cloud
from lime_planner.ros.nodes.scene_node import make_scene
from lime_planner.scene.plants.grasp_targets import lime_targets


class SoakBench(Bench):
    """The operator's side; every joint state goes to the judge."""

    judge: Judge | None = None

    def _on_joint_state(self, msg: JointState) -> None:
        super()._on_joint_state(msg)
        if self.judge is not None:
            self.judge.state(self.q)
        del self.statuses[:-40]  # each holds a whole trajectory
        del self.paths[:-1]

    def set_on(self, node: str, values: dict[str, Any]) -> list[str]:
        """Set parameters of another node; the reasons of refusals."""
        client = self.others.setdefault(node, None) or self.node.create_client(SetParameters, f"{node}/set_parameters")
        self.others[node] = client
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
        assert client.wait_for_service(20.0), node
        return [outcome.reason for outcome in self.result(client.call_async(request)).results if not outcome.successful]

    @property
    def others(self) -> dict[str, Any]:
        """Clients of other nodes."""
        return self.__dict__.setdefault("_others", {})


class Steps:
    """What may happen in a run, each a method; `check` judges what came of it."""

    def __init__(self, bench: SoakBench, robot: Robot, rng: np.random.Generator, *, labelled: bool) -> None:
        self.bench, self.robot, self.rng, self.labelled = bench, robot, rng, labelled
        self.judge = bench.judge = Judge(robot)
        self.violations: list[str] = []
        self.codes: Counter[str] = Counter()
        self.examples: dict[str, str] = {}
        self.waits: dict[str, list[float]] = {"answer": [], "preempted": [], "stop": []}
        self.requests = self.judged = self.blocked = self.arrived = 0
        self.actions: Counter[str] = Counter()
        self.fruit_target = bench.node.create_publisher(PointStamped, "fruit_target", qos.NEWEST)
        self.candidates = bench.node.create_publisher(PoseArray, "grasp_candidates", qos.NEWEST)
        bench.wait(lambda: self.judge.newest() is not None, 10.0, "joint states")

    # ---- what a step is made of ----

    def ask(self, name: str, request: Any = None) -> Any:
        """Send a request; its answer is judged when it comes."""
        self.requests += 1
        self.judge.asked(name)
        began = time.monotonic()
        future = self.bench.call_async(name, request)
        future.began, future.kind = began, name
        future.add_done_callback(lambda _: setattr(future, "ended", time.monotonic()))
        return future

    def answer(self, future: Any) -> str:
        """Wait for an answer and judge it; its code."""
        try:
            response = self.bench.result(future, ANSWER_S)
        except AssertionError:
            self.violations.append(f"{future.kind}: no answer within {ANSWER_S} s")
            return ""
        self.waits["answer"].append(time.monotonic() - future.began)
        if future.kind == "preview_to":
            return "SUCCEEDED" if response.plan.poses else "refused"
        code = code_of(response.message)
        self.judge.answered(future.kind)
        self.codes[f"{future.kind} {code}"] += 1
        self.examples[code] = response.message[:300]
        odd = code not in Status.__members__ or code == "INTERNAL_ERROR" or len(response.message) < len(code) + 5
        if odd or response.success != (code == "SUCCEEDED"):
            self.violations.append(f"{future.kind} answered {response.success} {response.message!r}")
        return code

    def pause(self, longest_s: float) -> None:
        """Let time pass."""
        time.sleep(float(self.rng.uniform(0.0, longest_s)))

    def new_scene(self) -> None:
        """Publish another plant (or the same one again) through the scene node."""
        values = {"seed": int(self.rng.integers(1, 40)), "density": str(self.rng.choice(["sparse", "medium"]))}
        published = make_scene({**SCENE, **values})
        self.targets = [pose for pose in [published.target, *lime_targets(published.scene, self.rng)] if pose is not None]
        self.fruits = published.scene.fruit_centres
        left_out = None if self.labelled or published.target is None else published.target[:3]
        reasons = self.bench.set_on("scene", values)
        self.judge.publish(published.scene, left_out)
        if reasons:
            self.violations.append(f"the scene node refused {values}: {reasons}")
        time.sleep(0.3)

    def new_twig(self) -> None:
        """Publish the stems and one more, where the tool will be in some seconds."""
        q, target = self.judge.later(float(self.rng.uniform(2.0, 5.0)))
        if q is None or self.judge.world is None:
            return
        twig = self.robot.forward(q)[:3, 3] + np.linspace(-0.06, 0.06, 100)[:, None] * np.array([[0.0, 0.0, 1.0]])
        scene = self.judge.world.scene
        stems = np.concatenate([scene.stem_points, twig.astype(np.float32)])
        scene = dataclasses.replace(scene, stem_points=stems)
        leaf, stem = encode_cloud(scene.leaf_points), encode_cloud(scene.impermeable_points(target, EXCLUSION_M))
        leaf.header.frame_id = stem.header.frame_id = scene.frame_id
        self.judge.publish(scene, target)
        self.bench.send_clouds(leaf, stem)
        time.sleep(0.3)

    def new_target(self) -> None:
        """Send a target in the plant, or close to where the tool is: a pose, a fruit or several poses; the newest counts."""
        if self.rng.random() < 0.25 and self.fruits is not None:
            x, y, z = (float(number) for number in self.fruits[int(self.rng.integers(len(self.fruits)))])
            self.send(self.fruit_target, PointStamped(point=Point(x=x, y=y, z=z)))
            return
        if self.rng.random() < 0.2:
            chosen = self.rng.integers(len(self.targets), size=int(self.rng.integers(1, 6)))
            self.send(self.candidates, PoseArray(poses=[to_pose(self.targets[int(i)]) for i in chosen]))
            return
        if self.rng.random() < 0.6:
            pose = self.targets[int(self.rng.integers(len(self.targets)))]
        else:
            q = self.bench.q + self.rng.uniform(-0.4, 0.4, self.robot.n)
            q = np.where(self.robot.continuous, q, np.clip(q, self.robot.lower + 0.1, self.robot.upper - 0.1))
            pose = matrix_to_pose(self.robot.forward(q))
        self.bench.send_target(pose)
        time.sleep(0.05)

    def send(self, publisher: Any, msg: Any) -> None:
        """Publish a target of another kind than a pose."""
        self.bench.wait(publisher.get_subscription_count, 20.0, "a subscriber of the target")
        msg.header.frame_id, msg.header.stamp = "base", self.bench.node.get_clock().now().to_msg()
        publisher.publish(msg)
        time.sleep(0.05)

    # ---- the steps ----

    def go(self) -> None:
        """Plan, move for a while, and let the next step come."""
        self.new_target()
        if self.answer(self.ask("plan")) == "SUCCEEDED":
            self.pause(3.0)

    def arrive(self) -> None:
        """Plan and wait until the motion has ended."""
        self.new_target()
        if self.answer(self.ask("plan")) == "SUCCEEDED":
            self.wait_end()
            self.check_arrival()

    def reach_nearby(self) -> None:
        """Reach a pose close to where the tool is, for certain: the first step of every run."""
        for _ in range(10):
            q = self.bench.q + self.rng.uniform(-0.25, 0.25, self.robot.n)
            self.bench.send_target(matrix_to_pose(self.robot.forward(q)))
            time.sleep(0.1)
            if self.answer(self.ask("plan")) == "SUCCEEDED":
                self.wait_end()
                self.check_arrival()
                return
        self.violations.append(f"no pose nearby could be reached: {self.examples}")

    def preempt(self) -> None:
        """A newer request while one plans or moves."""
        self.new_target()
        older = self.ask("plan")
        self.pause(0.8)
        self.new_target()
        newer = self.ask("plan")
        if self.answer(older) == "PREEMPTED":
            self.waits["preempted"].append(getattr(older, "ended", time.monotonic()) - newer.began)
        self.answer(newer)

    def stop(self) -> None:
        """Stop whatever goes on, at a random moment."""
        self.new_target()
        older = self.ask("plan")
        self.pause(2.0)
        moving, sent = older.done() and self.moving(), len(self.bench.commands)
        stopping = self.ask("stop")
        self.requests -= 1  # has no plan_id
        if moving:
            self.bench.wait(lambda: len(self.bench.commands) > sent or not self.moving(), 2.0, "the stop")
            if len(self.bench.commands) > sent:
                self.waits["stop"].append(self.bench.commands[-1][0] - stopping.began)
        if self.answer(stopping) != "SUCCEEDED":
            self.violations.append("a stop failed")
        self.answer(older)

    def look_first(self) -> None:
        """Preview, then carry it out."""
        self.new_target()
        if self.answer(self.ask("preview")) == "SUCCEEDED" and self.answer(self.ask("execute")) == "SUCCEEDED":
            self.pause(2.0)

    def preview_anywhere(self) -> None:
        """Preview to a pose of the request."""
        request = GetPlan.Request()
        request.goal.header.frame_id = str(self.rng.choice(["base", "base", "moon", ""]))
        request.goal.pose = to_pose(self.targets[int(self.rng.integers(len(self.targets)))])
        self.answer(self.ask("preview_to", request))

    def retreat(self) -> None:
        """Back out."""
        if self.answer(self.ask("retreat")) == "SUCCEEDED":
            self.pause(3.0)

    def burst(self) -> None:
        """Many at once."""
        for future in [self.ask(str(self.rng.choice(["plan", "preview", "execute", "retreat"]))) for _ in range(6)]:
            self.answer(future)

    def bad_target(self) -> None:
        """A target that cannot be used never moves the arm to the one before."""
        sent = self.judge.motions + len(self.bench.commands) - self.judged
        good = list(self.targets[0])
        bad = [
            ([math.nan, *good[1:]], "base"),
            ([*good[:3], 0.0, 0.0, 0.0, 0.0], "base"),
            (good, ""),
            (good, "moon"),
            ([9.0, *good[1:]], "base"),
        ]
        pose, frame = bad[int(self.rng.integers(len(bad)))]
        self.bench.send_target(pose, frame)
        time.sleep(0.2)
        if self.answer(self.ask("plan")) == "SUCCEEDED":
            self.violations.append(f"a plan to the target {pose} in {frame!r} succeeded (after {sent} motions)")

    def bad_cloud(self) -> None:
        """A stem cloud that cannot be used permits no motion."""
        msg = cloud(30)
        kind = int(self.rng.integers(4))
        if kind == 0:
            msg.fields = msg.fields[:2]
        elif kind == 1:
            msg.header.frame_id = "moon"
        elif kind == 2:
            msg.data = msg.data[:-3]
        else:
            msg = cloud(0)
        self.bench.send_clouds(None, msg)
        self.new_target()
        time.sleep(0.3)
        if self.answer(self.ask("plan")) == "SUCCEEDED":
            self.violations.append(f"a plan with a bad stem cloud (kind {kind}) succeeded")
        self.new_scene()

    def change_scene(self) -> None:
        """Another plant, at rest."""
        self.wait_end(stop=True)
        self.new_scene()

    def surprise(self) -> None:
        """Another plant, or one more twig, while the arm moves: it must stop if a stem stands in its way."""
        self.new_target()
        if self.answer(self.ask("plan")) != "SUCCEEDED":
            return
        self.pause(0.5)
        self.check()
        before = len(self.bench.commands)
        if self.rng.random() < 0.3:
            self.new_scene()
        else:
            self.new_twig()
        words = self.judge.blocked(STEM_STOP_S) if self.moving() else ""
        if words:
            self.blocked += 1
            deadline = time.monotonic() + STEM_STOP_S
            while self.moving() and len(self.bench.commands) == before and time.monotonic() < deadline:
                time.sleep(0.01)
            if self.moving() and len(self.bench.commands) == before:
                self.violations.append(f"a stem appeared on the path and the arm was not stopped: {words}")

    def fault(self) -> None:
        """The arm misbehaves for one motion."""
        values = dict(FAULTS[int(self.rng.integers(len(FAULTS)))])
        self.bench.set_on("mock_arm", values)
        self.new_target()
        if self.answer(self.ask("plan")) == "SUCCEEDED":
            self.pause(2.0)
        self.bench.set_on("mock_arm", {**CALM, "shuffle": False})
        time.sleep(0.4)

    def turn(self) -> None:
        """The driver reports continuous joints some turns away."""
        self.wait_end(stop=True)
        turns = [int(self.rng.integers(-3, 4)) if free else 0 for free in self.robot.continuous]
        self.bench.set_on("mock_arm", {"wrap_offset_turns": turns})
        time.sleep(0.5)

    def parameters(self) -> None:
        """A setting, good or bad."""
        if self.rng.random() < 0.7:
            values = SETTINGS[int(self.rng.integers(len(SETTINGS)))]
            if any(self.bench.set(**values)):
                self.violations.append(f"{values} was refused")
        else:
            values = BAD_SETTINGS[int(self.rng.integers(len(BAD_SETTINGS)))]
            if not all(self.bench.set(**values)):
                self.violations.append(f"{values} was accepted")

    def forbid(self) -> None:
        """Motion disabled stops what runs and sends nothing."""
        self.bench.set(motion_enabled=False)
        self.new_target()
        if self.answer(self.ask("plan")) == "SUCCEEDED":
            self.violations.append("a plan was sent although motion is disabled")
        self.bench.set(motion_enabled=True)

    # ---- around the steps ----

    def moving(self) -> bool:
        """Whether a motion of the planner runs, by its status."""
        statuses = list(self.bench.statuses)
        return bool(statuses) and statuses[-1]["phase"] == "EXECUTING"

    def check_arrival(self) -> None:
        """A motion that ended well has the arm at its last point, every turn counted."""
        last = np.array(self.bench.commands[-1][1].points[-1].positions)
        rests = self.judge.nearest(np.inf, last)
        off = np.inf if rests is None else np.abs(rests - last).max()
        if self.bench.statuses[-1].get("execution_code") == "SUCCEEDED":
            self.arrived += 1
            if off > ARRIVED_RAD:
                self.violations.append(f"a motion ended {off:.3f} rad from its last point")

    def wait_end(self, stop: bool = False) -> None:
        """Wait until nothing moves."""
        if stop:
            self.requests -= 1
            self.answer(self.ask("stop"))
        self.bench.wait(lambda: self.bench.statuses and self.bench.statuses[-1]["phase"] in ("DONE", "IDLE"), 60.0, "the end of a motion")

    def check(self) -> None:
        """Judge what was commanded since the last time."""
        while self.judged < len(self.bench.commands):
            at_s, msg = self.bench.commands[self.judged]
            self.judged += 1
            # The status that tells what a motion is for comes right after it.
            deadline = time.monotonic() + 2.0
            while not self.judge.knows(msg, list(self.bench.statuses)) and time.monotonic() < deadline:
                time.sleep(0.02)
            self.judge.command(at_s, msg, list(self.bench.statuses))
