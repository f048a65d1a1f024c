"""Obstacles are kept from one plan to the next: every parameter that they are made of is marked, and no other."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from arm_helpers import pipeline_of

from lime_planner.core.errors import ParameterError
from lime_planner.core.parameters import PARAMETERS, Parameter, Settings, settings_from
from lime_planner.pipeline.obstacles import Obstacles, prepare
from lime_planner.pipeline.spots import Spot, spot_at
from lime_planner.scene.scene import Scene

TARGET = np.array([0.45, 0.05, 0.4])
#: What the obstacles are built around: an exact pose, and a fruit, which is hard but for its stalk.
SPOTS = (spot_at(TARGET), Spot((0.45, 0.05, 0.4), fruit_radius_m=0.02))
#: Values of parameters for which no other value can be guessed from type and range.
OTHERS: dict[str, list[Any]] = {
    "keep_out_boxes": [[0.2, 0.2, 0.2, 0.3, 0.3, 0.3]],
    "workspace_box": [[-1.0, -1.0, -0.2, 1.0, 1.0, 1.4]],
    "arm_joints": [["a", "b"]],
    "finger_positions": [["j2s6s200_joint_finger_1: 0.5"]],
}
#: Memory of the exact checker that holds nothing before its first check.
SCRATCH = {"_poses", "_extents", "_tool", "_near", "_buffers"}


def others(parameter: Parameter) -> list[Any]:
    """Allowed values that are not the default."""
    low, high, default = parameter.minimum, parameter.maximum, parameter.default
    if parameter.name in OTHERS:
        guesses: list[Any] = OTHERS[parameter.name]
    elif parameter.choices:
        guesses = list(parameter.choices)
    elif parameter.kind is bool:
        guesses = [not default]
    elif parameter.kind is str:
        guesses = [default + "other"]
    elif parameter.kind in (int, float):
        guesses = [default * 2, default * 0.7, *(v for v in (low, high) if v is not None and not default)]
    else:
        guesses = []
    allowed = []
    for value in guesses:
        try:
            settings_from({parameter.name: value})
        except ParameterError:
            continue
        if value != default:
            allowed.append(value)
    assert allowed, f"name another value of {parameter.name} in OTHERS of this test"
    return allowed


@cache
def scene() -> Scene:
    """Stems and leaves around the target, the leaves of several costs."""
    points = TARGET + np.random.default_rng(4).uniform(-0.2, 0.2, (600, 3))
    costs = np.where(np.arange(600) % 5 == 0, 2.0, np.where(np.arange(600) % 7 == 0, 0.0, 1.0))
    return Scene.from_points(points, np.arange(600) % 2, permeability_cost=costs, frame_id="base")


def parts(value: Any) -> Iterator[bytes]:
    """Everything that a value holds of arrays, numbers and names, one after another."""
    if isinstance(value, np.ndarray):
        yield f"{value.shape} {value.dtype}".encode() + value.tobytes()
    elif isinstance(value, (bool, int, float, str, type(None), np.generic)):
        yield repr(value).encode()
    elif isinstance(value, dict):
        for key in value:
            yield from (repr(key).encode(), *parts(value[key]))
    elif isinstance(value, (tuple, list)):
        for item in value:
            yield from parts(item)
    elif type(value).__module__.startswith(("lime_planner.collision", "lime_planner.pipeline.spots")):
        yield from parts({name: held for name, held in vars(value).items() if name not in SCRATCH})


def fingerprint(around: list[Obstacles]) -> str:
    """What the search and the exact check meet: fields and points, radii, boxes, and the exact checker's shapes."""
    built = [(each.world, each.hard, each.leaves, each.spot, each.counts, each.exact_checker()) for each in around]
    return hashlib.sha256(b"\0".join(parts(built))).hexdigest()


def fresh(settings: Settings) -> list[Obstacles]:
    pipeline = pipeline_of()
    return [prepare(pipeline.robot, pipeline.shapes, scene(), spot, settings) for spot in SPOTS]


@cache
def usual() -> str:
    return fingerprint(fresh(settings_from()))


@pytest.mark.parametrize("name", PARAMETERS)
def test_what_changes_the_obstacles_is_marked_so(name: str) -> None:
    pipeline, parameter = pipeline_of(), PARAMETERS[name]
    built = {fingerprint(fresh(settings_from({name: value}))) for value in others(parameter)}
    changed = any(value != usual() for value in built)
    assert changed is parameter.shapes_obstacles, f"{name} {'changes' if changed else 'does not change'} the obstacles"
    for value in others(parameter)[:1]:
        # A plan with other settings before it leaves nothing of its obstacles to the next.
        assert fingerprint([pipeline.obstacles(scene(), spot, settings_from()) for spot in SPOTS]) == usual()
        changed = settings_from({name: value})
        now = [pipeline.obstacles(scene(), spot, changed) for spot in SPOTS]
        assert fingerprint(now) == fingerprint(fresh(changed)) and all(each.settings == changed for each in now)


def test_the_comparison_sees_a_moved_point() -> None:
    obstacles, around_fruit = fresh(settings_from())
    assert fingerprint([dataclasses.replace(obstacles, hard=obstacles.hard + np.float32(1e-6)), around_fruit]) != usual()
    fields = obstacles.world.fields
    swapped = obstacles.world._replace(fields=fields._replace(stems=fields.leaves))
    assert fingerprint([dataclasses.replace(obstacles, world=swapped), around_fruit]) != usual()
