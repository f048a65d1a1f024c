"""What the page says and draws of a plan, without a browser: headline, figures, plots, directions, and what is under the pointer."""

from __future__ import annotations

import dataclasses
import gzip
import re

import numpy as np
import pytest
from arm_helpers import pipeline_of, plant, robot_named, scene_of, settings

from lime_planner.core.geometry import matrix_to_pose, pose_to_matrix
from lime_planner.core.status import Status
from lime_planner.output.timeline import timeline_of
from lime_planner.pipeline.in_the_way import in_the_way
from lime_planner.pipeline.result import PlanRecord
from lime_planner.pipeline.targets import pose_target
from lime_planner.robot.model import home
from lime_planner.viewer import words
from lime_planner.viewer.backend import Activity, Moment
from lime_planner.viewer.cameras import placed
from lime_planner.viewer.goal import angles_of, frame_of
from lime_planner.viewer.head import with_our_head
from lime_planner.viewer.plots import charts, spans, ticks
from lime_planner.viewer.pointing import Pointing, Ray


@pytest.fixture(scope="module")
def found() -> PlanRecord:
    scene, chosen = plant(15), settings(iterations=400, seed=3)
    assert scene.target_pose is not None
    result = pipeline_of().plan(scene, pose_to_matrix(scene.target_pose), home(robot_named()), chosen)
    return PlanRecord(1, scene, chosen, scene.target_pose, result)


def test_a_refusal_is_told_from_a_find(found: PlanRecord) -> None:
    message = "GOAL_IN_STEM: all 3 <b>configurations</b> are blocked"
    refused = words.status(Moment(Activity.IDLE, message, settings(), blocked_motion="no plan"), "", [], [])
    assert 'class="lp-status refused"' in refused and 'data-state="Refused: GOAL_IN_STEM"' in refused
    assert "All 3 &lt;b&gt;configurations&lt;/b&gt; are blocked" in refused
    made = words.status(Moment(Activity.IDLE, found.result.message, settings(), shown=found), "", [], ["a <note>"])
    assert 'class="lp-status found"' in made and "A path is found; nothing has moved" in made and "a &lt;note&gt;" in made
    for calm in ("CANCELLED: stopped from the page", "press Plan"):
        assert "refused" not in words.status(Moment(Activity.IDLE, calm, settings(), blocked_motion="no plan"), "", [], [])
    assert "refused" not in words.status(Moment(Activity.PLANNING, message, settings()), "", [], [])


def test_table_and_plots_measure_the_same(found: PlanRecord) -> None:
    timeline = timeline_of(pipeline_of(), found)
    table = words.figures(found, timeline, "")
    assert f"{timeline.leaf_contact_rad:.3f} rad" in table and f"{1e3 * timeline.clearance_m.min():.1f} mm" in table
    assert f"{timeline.cost[-1]:.2f} rad" in table
    curves = re.findall(r'<polyline class="curve"[^>]*points="([^"]+)"', charts([timeline]))
    lowest = max(float(point.split(",")[1]) for point in curves[0].split())
    assert lowest == pytest.approx(92.0 - 74.0 * 1e3 * timeline.clearance_m.min() / 100.0, abs=0.06)
    other = dataclasses.replace(found, number=2, result=dataclasses.replace(found.result, planning_time_s=1e3))
    beside = words.comparison((found, timeline), (other, timeline))
    assert beside.count("better") == 1 and "plan 2" in beside
    refused = dataclasses.replace(found, number=3, result=dataclasses.replace(found.result, status=Status.NO_PATH, trajectory=None))
    assert "NO_PATH" in words.comparison((found, timeline), (refused, None)) and words.figures(None, None, "") == ""


def test_ticks_are_round_and_within() -> None:
    for top in (1e-3, 0.7, 3.0, 4.99, 33.0, 100.0, 12345.0):
        marks = ticks(top)
        assert marks[0] == 0.0 and marks[-1] <= top * (1.0 + 1e-9) and 3 <= len(marks) <= 6
    assert spans(np.array([False, True, True, False, True])) == [(0, 3), (3, 4)]


def test_angles_and_frames_agree() -> None:
    rng = np.random.default_rng(0)
    for heading, slope, roll in zip(rng.uniform(-180, 180, 50), rng.uniform(-90, 90, 50), rng.uniform(-180, 180, 50), strict=True):
        T = np.eye(4)
        T[:3, :3] = frame_of((heading, slope, roll))
        np.testing.assert_allclose(frame_of(angles_of(matrix_to_pose(T))), T[:3, :3], atol=1e-6)
    np.testing.assert_allclose(frame_of((0.0, 0.0, 0.0))[:, 2], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(frame_of((30.0, 90.0, 0.0))[:, 2], [0.0, 0.0, 1.0], atol=1e-12)


def test_what_is_under_the_pointer_is_named(found: PlanRecord) -> None:
    scene, robot = found.scene, robot_named()
    assert scene.leaf_triangles is not None and scene.leaf_triangle_ids is not None
    assert scene.fruit_centres is not None and scene.fruit_radii is not None
    named = Pointing(scene, reach_m=2.0)
    middles = scene.leaf_triangles.mean(axis=1).astype(np.float64)
    out = int(np.argmax(middles[:, 2]))  # nothing above it
    above = Ray.through(middles[out] + [0.0, 0.0, 0.5], np.array([0.0, 0.0, -3.0]))
    leaf = named.under(above)
    assert leaf is not None and (leaf.kind, leaf.title) == ("leaf", f"Leaf {scene.leaf_triangle_ids[out]}")
    behind = named.under(above, shows=lambda part: part != "leaves")
    assert behind is None or behind.kind != "leaf", "what is hidden is not named"
    far = Pointing(scene, reach_m=0.1).under(above)
    assert far is None or far.kind == "lime", "what is too far away to be drawn is not named"
    assert named.under(Ray.through(np.full(3, 5.0), np.array([0.0, 0.0, 1.0]))) is None
    for lime, (centre, radius) in enumerate(zip(scene.fruit_centres, scene.fruit_radii, strict=True)):
        near = named.under(Ray.through(centre + [0.0, 0.0, 1.01 * radius], np.array([0.0, 0.0, -1.0])))
        assert near is not None and (near.kind, near.title) == ("lime", f"Lime {lime}")
    q = home(robot)
    link = robot.links[2]
    inside = robot.link_poses(q)[link.joint] @ [*np.asarray(link.vertices).mean(axis=0), 1.0]
    ray = Ray.through(inside[:3] + [0.0, 2.0, 0.0], np.array([0.0, -1.0, 0.0]))
    arm = named.under(ray, arm=(robot, q), shows=lambda part: part == "arm")
    assert arm is not None and arm.kind == "arm" and any(f"link {link.name}." in arm.sentence for link in robot.links)

    bare = Pointing(scene_of(stems=[[0.5, 0.0, 0.5]], leaves=[[0.7, 0.0, 0.5]]), reach_m=2.0)
    along = np.array([1.0, 0.0, 0.0])
    stem = bare.under(Ray.through(np.array([0.0, 0.0, 0.5]), along))
    assert stem is not None and (stem.title, stem.sentence) == ("Stem point 0", "At 0.50 0.00 0.50 m. Never touched.")
    leaf = bare.under(Ray.through(np.array([0.6, 0.0, 0.5]), along))
    assert leaf is not None and leaf.title == "Leaf"


@pytest.mark.parametrize(
    "query", ["", "ray=", "ray=1,2,3", "ray=a,b,c,d,e,f", "ray=1,2,3,0,0,0", "ray=1,2,3,nan,0,1", "ray=1,2,3,4,5,6,7", "%ff"]
)
def test_no_ray_is_read_from_nonsense(query: str) -> None:
    assert Ray.read(query) is None


def test_what_is_in_the_way_can_be_drawn() -> None:
    robot, chosen = robot_named(), settings(iterations=50, seed=3)
    T = robot.forward(home(robot))
    wall = T[:3, 3] + 0.01 * np.stack(np.meshgrid(*[np.arange(-4, 5)] * 3), axis=-1).reshape(-1, 3)
    scene = scene_of(stems=wall, leaves=[])
    q = home(robot)
    blocked = pipeline_of().plan(scene, pose_target(matrix_to_pose(T)), q, chosen)
    assert blocked.status is Status.START_IN_STEM
    shown = in_the_way(pipeline_of(), PlanRecord(1, scene, chosen, matrix_to_pose(T), blocked))
    assert shown is not None and shown.hit.place is not None and shown.hit.link in blocked.message
    np.testing.assert_allclose(shown.q, q)
    goal = robot.forward(q + np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0]))
    there = scene_of(stems=wall - T[:3, 3] + goal[:3, 3], leaves=[])
    result = pipeline_of().plan(there, pose_target(matrix_to_pose(goal)), q, chosen)
    assert result.status is Status.GOAL_IN_STEM
    shown = in_the_way(pipeline_of(), PlanRecord(2, there, chosen, matrix_to_pose(goal), result))
    assert shown is not None and shown.hit.place is not None
    np.testing.assert_allclose(robot.forward(shown.q), goal, atol=1e-3)


def test_cameras_look_at_the_target() -> None:
    target = np.array([0.5, 0.2, 0.6, 0.0, 0.0, 0.0, 1.0])
    for name in ("Start", "Side", "Top", "Target"):
        for aim in (target, None):
            position, look_at = placed(name, aim)
            assert np.isfinite([*position, *look_at]).all() and 0.3 < np.linalg.norm(position - look_at) < 2.5
    np.testing.assert_allclose(placed("Target", target)[1], target[:3])


@pytest.mark.parametrize("gzipped", [False, True])
def test_our_head_is_put_in(gzipped: bool) -> None:
    page = b'<html><head><link\n rel="icon"\n href="data:x"/><title>Viser</title></head><body>&</body></html>'
    body = with_our_head(gzip.compress(page) if gzipped else page, gzipped=gzipped)
    html = gzip.decompress(body) if gzipped else body
    assert html.count(b"<title>Lime planner</title>") == 1 and html.count(b'rel="icon"') == 1 and b"data:x" not in html
    assert b"prefers-color-scheme" in html and html.endswith(b"<body>&</body></html>")
