"""The picture of a refused plan: the blocked arm, what blocks it, keep-out boxes, the target even far away, and the sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm_helpers import pipeline_of, robot_named, scene_of, settings

from lime_planner.core.geometry import matrix_to_pose
from lime_planner.core.status import Status
from lime_planner.output import picture
from lime_planner.output.picture import TARGET, draw_plan
from lime_planner.output.refusal_marks import BLOCKED, boxes_shown, within_sight, wrapped
from lime_planner.pipeline import PlanResult
from lime_planner.pipeline.in_the_way import in_the_way_of
from lime_planner.robot.model import home
from lime_planner.scene.scene import Scene

WALL = 0.01 * np.stack(np.meshgrid(*[np.arange(-4, 5)] * 3), axis=-1).reshape(-1, 3)
ASIDE = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0])  # of the start, where the goal is
SELF = np.array([4.7, 1.0, 0.4, 4.7, 5.7, 1.3])  # link 3 and link 5 touch


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "_PANEL_PIXELS", 250)


def refused(scene: Scene, T: np.ndarray, q: np.ndarray, **chosen: object) -> PlanResult:
    result = pipeline_of().plan(scene, T, q, settings(iterations=50, seed=3, **chosen))
    assert not result.succeeded
    return result


def text_of(result: PlanResult, scene: Scene, folder: Path) -> str:
    """Return the words of a picture."""
    import matplotlib

    with matplotlib.rc_context({"svg.fonttype": "none"}):
        return draw_plan(result, scene, robot_named(), folder / "a.svg").read_text()


def pixels_like(result: PlanResult, scene: Scene, folder: Path, colour: tuple[float, float, float], within: int) -> np.ndarray:
    """Return which columns of a picture have how many pixels of a colour, its first lines with the title left out."""
    from PIL import Image

    image = np.asarray(Image.open(draw_plan(result, scene, robot_named(), folder / "a.png")).convert("RGB")).astype(int)
    return np.asarray((np.abs(image[200:-220] - np.round(255 * np.array(colour))).max(axis=2) <= within).sum(axis=0))


def test_a_blocked_goal_shows_the_arm_there_and_what_it_meets(tmp_path: Path) -> None:
    robot = robot_named()
    q, T = home(robot), robot.forward(home(robot) + ASIDE)
    scene = scene_of(stems=WALL + T[:3, 3], leaves=[])
    result = refused(scene, T, q)
    assert result.status is Status.GOAL_IN_STEM
    text = text_of(result, scene, tmp_path)
    for words in ("GOAL_IN_STEM", "arm at the start", "blocked, and by what", "where they meet", "target and approach"):
        assert words in text
    sentence = result.message.partition(": ")[2]
    assert sentence[1:40] in text, "the sentence stands above the picture"
    assert pixels_like(result, scene, tmp_path, BLOCKED, 40).sum() > 800
    found = in_the_way_of(robot, scene, result)
    assert found is not None and found.hit.place is not None and len(found.obstacle(scene)) and found.box is None
    np.testing.assert_allclose(found.place(robot), found.hit.place)


def test_a_blocked_start_is_drawn_in_red_alone(tmp_path: Path) -> None:
    robot = robot_named()
    q, T = home(robot), robot.forward(home(robot))
    scene = scene_of(stems=WALL + T[:3, 3], leaves=[])
    result = refused(scene, robot.forward(q + ASIDE), q)
    assert result.status is Status.START_IN_STEM
    text = text_of(result, scene, tmp_path)
    assert "arm at the start" not in text and "the rest of the arm there" in text
    assert pixels_like(result, scene, tmp_path, BLOCKED, 40).sum() > 800


def test_links_that_touch_each_other_are_both_red() -> None:
    robot = robot_named()
    scene = scene_of(stems=[[2.0, 2.0, 2.0]], leaves=[])
    result = refused(scene, robot.forward(home(robot)), SELF)
    assert result.status is Status.START_INVALID
    found = in_the_way_of(robot, scene, result)
    assert found is not None and found.hit.what == "self" and len(set(found.links)) == 2
    place = found.place(robot)
    assert place is not None and len(found.obstacle(scene)) == 0
    for name in found.links:
        vertices, _ = picture.link_mesh(robot, SELF, [name])
        assert np.linalg.norm(vertices - place, axis=1).min() < 0.03


def test_a_keep_out_box_is_drawn_and_red_where_it_is_met(tmp_path: Path) -> None:
    robot = robot_named()
    q, T = home(robot), robot.forward(home(robot) + ASIDE)
    around = [*(T[:3, 3] - 0.05), *(T[:3, 3] + 0.05)]
    scene = scene_of(stems=[[2.0, 2.0, 2.0]], leaves=[])
    beside = [0.2, -0.9, 0.0, 1e3, -0.8, 0.2]
    result = refused(scene, T, q, keep_out_boxes=[*beside, *around])
    assert result.status is Status.GOAL_IN_STEM and "keep-out box" in result.message
    found = in_the_way_of(robot, scene, result)
    assert found is not None and found.box == 1
    text = text_of(result, scene, tmp_path)
    assert "keep-out box that is met" in text and ">keep-out box<" in text
    drawn = boxes_shown([*beside, 5.0, 5.0, 5.0, 6.0, 6.0, 6.0], 1.2)
    assert drawn[0].max() == 1.2 and np.isnan(drawn[1]).all()


@pytest.mark.parametrize("fruit", [False, True])
def test_a_target_out_of_reach_is_in_the_picture(fruit: bool, tmp_path: Path) -> None:
    robot = robot_named()
    q, T = home(robot), np.eye(4)
    T[:3, 3] = 3.0, 0.0, 0.5
    scene = scene_of(stems=[[0.6, 0.0, 0.3]], leaves=[])
    result = refused(scene, np.array([3.0, 0.0, 0.5]) if fruit else matrix_to_pose(T), q)
    assert result.status is Status.NO_IK_SOLUTION
    columns = pixels_like(result, scene, tmp_path, TARGET, 30)
    assert columns[: len(columns) // 2].sum() > 50 < columns[len(columns) // 2 :].sum(), "the ring is in both views"
    assert "end of the arm's reach" in text_of(result, scene, tmp_path)


def test_a_target_much_farther_away_is_pointed_to(tmp_path: Path) -> None:
    robot = robot_named()
    scene = scene_of(stems=[[0.6, 0.0, 0.3]], leaves=[])
    result = refused(scene, np.array([30.0, 0.0, 0.5]), home(robot))
    assert "target 30 m away" in text_of(result, scene, tmp_path)
    assert within_sight(np.array([3.0, 0.0, 0.5]), robot.reach_m) and not within_sight(np.array([30.0, 0.0, 0.5]), robot.reach_m)


def test_sentences_are_as_wide_as_the_picture() -> None:
    lines = wrapped("word " * 100, 8.0)
    assert len(lines) > 3 and max(map(len, lines)) <= 104 and wrapped("", 8.0) == []
