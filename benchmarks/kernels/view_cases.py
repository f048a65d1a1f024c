"""What `lime-planner bench kernels` times of views: the map of what they show, and a planned look."""

from __future__ import annotations

import numpy as np

from benchmarks.timing import Timing, repeat
from lime_planner.core.parameters import settings_from
from lime_planner.experiments.problems import SceneSpec, pipeline_of, scene_of
from lime_planner.pipeline.looks import plan_look
from lime_planner.pipeline.targets import pose_target
from lime_planner.robot.model import home
from lime_planner.scene.camera import seen_scene
from lime_planner.scene.scene import Scene
from lime_planner.scene.views.seen_map import make_seen_map

ROBOT = "kinova_j2s6s200"
PLANT = SceneSpec("dense-0", density="dense", seed=0)
VIEWS = ((0.0, 0.0, 0.6), (0.2, -0.7, 0.6), (0.2, 0.7, 0.6), (0.1, 0.0, 1.2), (0.0, -0.4, 0.3))
VOXEL_M = 0.005
ONE_VIEW_TARGET_S, FIVE_VIEWS_TARGET_S, LOOK_TARGET_S = 0.06, 0.3, 0.3


def cloud_of(views: int, points: int) -> Scene:
    """What the first of the views see of the plant, drawn again until there are so many points, a millimetre apart from each other."""
    scene, rng = seen_scene(scene_of(PLANT), VIEWS[:views]), np.random.default_rng(0)
    everything, labels, _ = scene.labelled_points()
    ids = np.concatenate([part for part in (scene.leaf_view_ids, scene.stem_view_ids, scene.fruit_view_ids) if part is not None])
    pick = rng.integers(0, len(everything), points)
    places = everything[pick] + rng.normal(0.0, 0.001, (points, 3))
    return Scene.from_points(places, labels[pick], viewpoints=scene.viewpoints, view_ids=ids[pick])


def maps(repeats: int) -> list[Timing]:
    """Maps of what was seen, voxels of 5 mm."""
    found = []
    for views, points, target_s in ((1, 100_000, ONE_VIEW_TARGET_S), (5, 100_000, FIVE_VIEWS_TARGET_S), (1, 5_000_000, None)):
        scene = cloud_of(views, points)
        words = f"what {views} view{'s' if views > 1 else ''} show, {points:,} points"
        samples, note = max(3, repeats // 5), f"{len(make_seen_map(scene, VOXEL_M).unseen)} unseen voxels of 5 mm"
        name = f"seen_map_{views}_{points}"
        found.append(repeat(name, words, lambda s=scene: make_seen_map(s, VOXEL_M), samples=samples, target_s=target_s, note=note))  # type: ignore[misc]
    return found


def look(repeats: int) -> Timing:
    """View, way and certificate of a look, after a plan with the same knowledge."""
    pipeline, plant = pipeline_of(ROBOT), scene_of(PLANT)
    assert plant.target_pose is not None
    scene, target, q = seen_scene(plant, [(-0.4, 0.2, 0.8)]), pose_target(plant.target_pose), home(pipeline.robot)
    settings = settings_from({"iterations": 1500, "threads": 1})
    plan = pipeline.plan(scene, target, q, settings, seed=1)
    plan_look(pipeline, scene, target, plan, q, settings, seed=1)
    return repeat(
        "look",
        "a planned look",
        lambda: plan_look(pipeline, scene, target, plan, q, settings, seed=1),
        samples=max(3, repeats // 5),
        target_s=LOOK_TARGET_S,
        note=f"{plan.unseen_contact_rad:.2f} rad of the plan are unseen",
    )
