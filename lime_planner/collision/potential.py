"""The repulsive potential field in the arm's joint space (paper, sections III-B and V)."""

from __future__ import annotations

from typing import Any

import numpy as np

from lime_planner.collision.distance_fields import sample
from lime_planner.collision.fast import Scratch
from lime_planner.collision.world import CAP_M
from lime_planner.core.jit import hot_kernel
from lime_planner.core.types import Array


@hot_kernel
def repulse(parts: Any, touching: bool, d_star: float, k_leaf: float, k_stem: float, force: Array) -> Any:
    """Add the repulsive force at the configuration checked last; the shortest distance, 0 or less where the arm touches something.

    d_obs is the shortest workspace distance between the arm's spheres and the cloud of each class (paper, section V); the force is
    -dU/dd times its gradient, through the Jacobian of the closest sphere. Distances in metres, forces per radian.
    """
    shapes = parts.shapes
    scratch: Scratch = parts.scratch
    poses = scratch.poses
    world = parts.world
    fields = world.fields
    h = 0.5 * fields.spacing_m
    nearest = CAP_M
    for channel in range(2):
        gain = k_stem if channel == 0 else k_leaf
        radius = world.stem_radius if channel == 0 else world.leaf_radius
        best = np.inf
        body = -1
        px = py = pz = 0.0
        for b in range(1, shapes.spacing.shape[0]):
            pose = poses[b]
            for c in range(shapes.coarse_start[b], shapes.coarse_start[b + 1]):
                sphere = shapes.coarse[c]
                x = pose[0, 0] * sphere[0] + pose[0, 1] * sphere[1] + pose[0, 2] * sphere[2] + pose[0, 3]
                y = pose[1, 0] * sphere[0] + pose[1, 1] * sphere[1] + pose[1, 2] * sphere[2] + pose[1, 3]
                z = pose[2, 0] * sphere[0] + pose[2, 1] * sphere[1] + pose[2, 2] * sphere[2] + pose[2, 3]
                if sample(fields, x, y, z)[channel] - sphere[3] - radius >= min(best, d_star):
                    continue
                for f in range(shapes.fine_start[c], shapes.fine_start[c + 1]):
                    sphere = shapes.fine[f]
                    x = pose[0, 0] * sphere[0] + pose[0, 1] * sphere[1] + pose[0, 2] * sphere[2] + pose[0, 3]
                    y = pose[1, 0] * sphere[0] + pose[1, 1] * sphere[1] + pose[1, 2] * sphere[2] + pose[1, 3]
                    z = pose[2, 0] * sphere[0] + pose[2, 1] * sphere[1] + pose[2, 2] * sphere[2] + pose[2, 3]
                    d = sample(fields, x, y, z)[channel] - sphere[3] - radius
                    if d < best:
                        best = d
                        body = b
                        px = x
                        py = y
                        pz = z
        if body < 0:
            continue
        nearest = min(nearest, best)
        if best <= 1e-4 or best > d_star:
            continue
        gx = (sample(fields, px + h, py, pz)[channel] - sample(fields, px - h, py, pz)[channel]) / (2.0 * h)
        gy = (sample(fields, px, py + h, pz)[channel] - sample(fields, px, py - h, pz)[channel]) / (2.0 * h)
        gz = (sample(fields, px, py, pz + h)[channel] - sample(fields, px, py, pz - h)[channel]) / (2.0 * h)
        strength = gain * (1.0 / best - 1.0 / d_star) / (best * best)
        for j in range(body):
            pose = poses[j + 1]
            zx = pose[0, 2]
            zy = pose[1, 2]
            zz = pose[2, 2]
            if parts.chain.prismatic[j]:
                slope = zx * gx + zy * gy + zz * gz
            else:
                rx = px - pose[0, 3]
                ry = py - pose[1, 3]
                rz = pz - pose[2, 3]
                slope = (zy * rz - zz * ry) * gx + (zz * rx - zx * rz) * gy + (zx * ry - zy * rx) * gz
            force[j] += strength * slope
    return min(nearest, 0.0) if touching else nearest
