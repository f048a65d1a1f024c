"""Transforms over time: what is interpolated, what is refused and why, and by which frame a base's motion is told."""

from __future__ import annotations

import numpy as np
import pytest

from lime_planner.core.base_motion import base_motion_m
from lime_planner.core.transform_history import NoTransform, TransformHistory

HALF = np.sqrt(0.5)


def moving() -> TransformHistory:
    """`map` > `odom` > `base` > `link` > `camera`, and `world` apart: odom turns by 90 degrees in 2 s, base and link move along x."""
    history = TransformHistory()
    history.add("map", "odom", [0, 0, 0, 0, 0, 0, 1], 10.0)
    history.add("map", "odom", [0, 0, 0, 0, 0, HALF, HALF], 12.0)
    for k in range(5):
        history.add("/odom", "base", [k, 0, 0, 0, 0, 0, 1], 10.0 + 0.5 * k)
        history.add("base", "link", [0.1 * k, 0, 0, 0, 0, 0, 1], 10.0 + 0.5 * k)
    history.add("link", "camera", [0, 0, 1, 0, 0, 0, 2.0], 0.0, static=True)
    history.add("world", "stone", [0, 0, 0, 0, 0, 0, 1], 0.0, static=True)
    return history


def test_every_part_of_a_chain_is_interpolated_and_inverted() -> None:
    history = moving()
    T = history.find("odom", "camera", 10.75)
    assert T[:3, 3] == pytest.approx([1.65, 0, 1])
    assert history.find("camera", "/odom", 10.75) @ T == pytest.approx(np.eye(4))
    turned = history.find("map", "base", 11.0)
    assert turned[:3, 3] == pytest.approx([2 * HALF, 2 * HALF, 0])
    assert turned[:2, 0] == pytest.approx([HALF, HALF])
    assert history.find("base", "base", 99.0) == pytest.approx(np.eye(4))


def test_the_newest_time_is_the_one_at_which_the_whole_chain_is_known() -> None:
    history = moving()
    history.add("odom", "base", [9, 0, 0, 0, 0, 0, 1], 13.0)
    assert history.find("odom", "base")[0, 3] == 9.0
    assert history.find("odom", "link")[0, 3] == pytest.approx(4.4), "link is known up to 12 s"


@pytest.mark.parametrize(
    ("frames", "stamp_s", "words", "may_come"),
    [
        (("odom", "camera"), 12.25, "'link' in 'base' is known up to 0.250 s before the stamp", True),
        (("odom", "camera"), 9.0, "known from 10.000 s only, 1.000 s after the stamp", False),
        (("odom", "moon"), 11.0, "'moon' is not known; known frames: base, camera, link, map, odom, stone, world", True),
        (("odom", "stone"), 11.0, "they are not connected", True),
    ],
)
def test_what_is_not_known_is_said(frames: tuple[str, str], stamp_s: float, words: str, may_come: bool) -> None:
    with pytest.raises(NoTransform, match=words) as caught:
        moving().find(*frames, stamp_s)
    assert caught.value.may_come is may_come


def test_clamping_takes_the_nearest_that_is_known() -> None:
    history = moving()
    assert history.find("odom", "base", 99.0, clamp=True)[0, 3] == 4.0
    assert history.find("odom", "base", 1.0, clamp=True)[0, 3] == 0.0


def test_the_past_is_dropped_late_ones_come_in_between_and_time_may_begin_again() -> None:
    history = TransformHistory(keep_s=1.0)
    for stamp_s in (1.0, 3.0, 2.5):
        history.add("base", "camera", [stamp_s, 0, 0, 0, 0, 0, 1], stamp_s)
    assert history.find("base", "camera", 2.75)[0, 3] == pytest.approx(2.75)
    with pytest.raises(NoTransform, match=r"known from 2\.500 s only"):
        history.find("base", "camera", 1.0)
    history.add("base", "mast", [7, 0, 0, 0, 0, 0, 1], 0.0, static=True)
    history.forget_moving()
    assert history.frames == ["base", "mast"]


def test_a_frame_follows_its_new_parent_and_loops_end() -> None:
    history = moving()
    history.add("world", "camera", [5, 0, 0, 0, 0, 0, 1], 11.0)
    assert history.find("world", "camera", 11.0)[0, 3] == 5.0
    loop = TransformHistory()
    for parent, child in (("a", "b"), ("b", "c"), ("c", "a")):
        loop.add(parent, child, [1, 0, 0, 0, 0, 0, 1], 1.0)
    assert loop.find("a", "c", 1.0).shape == (4, 4)
    assert loop.anchor("a", "a") is None or isinstance(loop.anchor("a", "a"), str)


@pytest.mark.parametrize(("source", "anchor"), [("map", "map"), ("odom", "odom"), ("camera", "odom"), ("base", "odom"), ("moon", None)])
def test_by_which_frame_a_base_is_seen_to_move(source: str, anchor: str | None) -> None:
    assert moving().anchor("base", source) == anchor


def test_a_base_that_stands_on_static_transforms_does_not_move() -> None:
    history = TransformHistory()
    history.add("world", "base", [1, 0, 0, 0, 0, 0, 1], 0.0, static=True)
    history.add("base", "link", [1, 0, 0, 0, 0, 0, 1], 5.0)
    assert history.anchor("base", "link") is None
    assert history.anchor("base", "world") == "world"


def test_how_far_a_motion_carries() -> None:
    T = np.eye(4)
    T[:3, 3] = [3.0, 4.0, 0.0]
    assert base_motion_m(T) == pytest.approx(5.0)
    T[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    assert base_motion_m(T) == pytest.approx(5.0 + np.pi / 2)
