"""The compiled planners against a plain transcription of the paper's algorithm 1 and of the reading taken of it."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from lime_planner.planning.rrt_star.planner import PaperOptions, plan_paper
from lime_planner.planning.spaces.plane import wall_g

WALL = [(50 + x, y) for x, y in ((-7.25, -10), (-7.25, 20), (-10.25, 20), (-10.25, 80), (-7.25, 80), (-7.25, 110))]
WALL += [(100 - x, y) for x, y in reversed(WALL)]
START, GOAL = np.array([10.0, 50.0]), np.array([90.0, 50.0])
K_ATT, K_REP, D_STAR, DELTA, C_PERM = 50.0, 500.0, 5.0, 3.0, 100.0


def in_wall(q: np.ndarray) -> bool:
    return bool(abs(q[0] - 50) < (10.25 if abs(q[1] - 50) <= 30 else 7.25))


def force(q: np.ndarray) -> np.ndarray:
    attraction = 2 * K_ATT * (GOAL - q)
    if in_wall(q):
        return attraction
    faces = zip(WALL, WALL[1:] + WALL[:1], strict=True)
    nearest = min((closest(q, np.array(a), np.array(b)) for a, b in faces), key=lambda p: math.dist(p, q))
    d = math.dist(nearest, q)
    return attraction + (K_REP * (1 / d - 1 / D_STAR) / d**2 * (q - nearest) / d if d <= D_STAR else 0.0)


def closest(q: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a + np.clip((q - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0) * (b - a))


@dataclass
class Reference:
    """Algorithm 1 as a list of nodes."""

    algorithm: str
    beta: float
    propagate: bool
    q: list[np.ndarray] = field(default_factory=lambda: [START])
    parent: list[int] = field(default_factory=lambda: [-1])
    cost: list[float] = field(default_factory=lambda: [0.0])

    def c(self, i: int) -> float:
        return C_PERM * in_wall(self.q[i])

    def extend(self, near: np.ndarray, rand: np.ndarray) -> np.ndarray:
        distance = math.dist(near, rand)
        if self.algorithm != "apf_rrt_star":
            return rand if distance <= DELTA else near + DELTA * (rand - near) / distance
        f = force(near)
        total = f @ (GOAL - near) / math.dist(GOAL, near)
        weight = 1 / (self.beta * max(0.0, total) / (2 * K_ATT * math.hypot(90, 50)) + 1)
        v = weight * (rand - near) / distance + (1 - weight) * f / np.linalg.norm(f)
        return np.asarray(near + DELTA * v / np.linalg.norm(v))

    def iterate(self, rand: np.ndarray) -> None:
        if self.algorithm == "p_rrt_star":
            for _ in range(10):
                rand = rand + 0.5 * force(rand) / np.linalg.norm(force(rand))
            rand = np.clip(rand, 0.0, 100.0)
        near = min(range(len(self.q)), key=lambda i: math.dist(self.q[i], rand))
        new = self.extend(self.q[near], rand)
        if not ((new >= 0.0) & (new <= 100.0)).all():
            return
        around = [i for i, q in enumerate(self.q) if (q - new) @ (q - new) <= DELTA**2 + 1e-9 or i == near]
        through = {i: self.cost[i] + math.dist(self.q[i], new) + self.c(i) for i in around}
        best = min(around, key=lambda i: through[i])
        self.q.append(new)
        self.parent.append(best)
        self.cost.append(through[best])
        last = len(self.q) - 1
        for i in around:
            cheaper = self.cost[last] + math.dist(new, self.q[i]) + self.c(last)
            if cheaper < self.cost[i] - 1e-9:
                self.parent[i] = last
                self.cost[i] = cheaper
                if self.propagate:
                    self.update_children(i)

    def update_children(self, i: int) -> None:
        for child in [j for j, p in enumerate(self.parent) if p == i]:
            self.cost[child] = self.cost[i] + math.dist(self.q[i], self.q[child]) + self.c(i)
            self.update_children(child)

    def result(self) -> float:
        """The traced path's own cost, from the node that gives the goal the smallest stored cost; inf where none is near."""
        near = [i for i, q in enumerate(self.q) if math.dist(q, GOAL) <= 5.0]
        if not near:
            return math.inf
        node = min(near, key=lambda i: self.cost[i] + self.c(i) + math.dist(self.q[i], GOAL))
        path = [GOAL]
        while node >= 0:
            path.append(self.q[node])
            node = self.parent[node]
        return sum(math.dist(a, b) for a, b in itertools.pairwise(path)) + C_PERM * sum(map(in_wall, path))


@pytest.mark.parametrize("propagate", [False, True])
@pytest.mark.parametrize(("algorithm", "beta"), [("rrt_star", 1.0), ("apf_rrt_star", 1.0), ("apf_rrt_star", 2.0), ("p_rrt_star", 1.0)])
def test_same_tree_as_the_transcription(algorithm: str, beta: float, propagate: bool) -> None:
    seed, iterations = 11, 600
    reference = Reference(algorithm, beta, propagate)
    for sample in 100.0 * np.random.default_rng(seed).random((iterations, 2)):
        reference.iterate(sample)
    options = PaperOptions.wall(algorithm, beta=beta, propagate=propagate)
    outcome = plan_paper(wall_g().space(), START, GOAL, options, seed, iterations=iterations)
    np.testing.assert_allclose(outcome.tree.rows, np.array(reference.q), atol=1e-6)
    np.testing.assert_array_equal(outcome.tree.parent, reference.parent)
    np.testing.assert_allclose(outcome.tree.cost, reference.cost, atol=1e-6)
    assert outcome.final.node_cost == pytest.approx(reference.result())
