"""Planar worlds: a map with permeable and impermeable polygons, read from JSON, built in, or made from a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lime_planner.core.errors import ProblemError, SceneError
from lime_planner.core.validation import TextFileError, read_json
from lime_planner.planning.spaces.plane_space import IMPERMEABLE, PERMEABLE, PlaneSpace, is_inside

__all__ = ["IMPERMEABLE", "PERMEABLE", "PlaneSpace", "PlaneWorld", "check_ends", "load_world", "random_wall", "wall_g", "world_from_dict"]

Corners = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class PlaneWorld:
    """A rectangular map with a start, a goal and polygons (open sets; those of one kind may overlap).

    Attributes:
        name: for titles and files.
        lower: smallest x and y [map units].
        upper: largest x and y.
        start: x and y.
        goal: x and y.
        permeable: polygons that may be crossed at a cost, each a tuple of corners (x, y); they may reach beyond the map.
        impermeable: polygons that block.
        prices: of the permeable polygons, >= 0; empty: 1 for each.
    """

    name: str
    lower: tuple[float, float]
    upper: tuple[float, float]
    start: tuple[float, float]
    goal: tuple[float, float]
    permeable: tuple[Corners, ...] = ()
    impermeable: tuple[Corners, ...] = ()
    prices: tuple[float, ...] = ()

    def space(self) -> PlaneSpace:
        """Return the world as a space with counters and scratch memory of its own (one for each thread)."""
        polygons = [np.asarray(p, dtype=np.float64) for p in (*self.permeable, *self.impermeable)]
        vertices = np.concatenate(polygons) if polygons else np.empty((0, 2))
        return PlaneSpace(
            lower=np.array(self.lower, dtype=np.float64),
            upper=np.array(self.upper, dtype=np.float64),
            counters=np.zeros(8, dtype=np.int64),
            vertices=vertices,
            offsets=np.cumsum([0, *(len(p) for p in polygons)]).astype(np.int64),
            kinds=np.array([PERMEABLE] * len(self.permeable) + [IMPERMEABLE] * len(self.impermeable), dtype=np.uint8),
            prices=np.array([*(self.prices or [1.0] * len(self.permeable)), *([0.0] * len(self.impermeable))]),
            boxes=np.array([[*p.min(axis=0), *p.max(axis=0)] for p in polygons]).reshape(-1, 4),
            scratch=np.empty(2 * len(vertices) + 4),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the world in the form of its JSON file."""
        return {
            "name": self.name,
            "map": {"lower": list(self.lower), "upper": list(self.upper)},
            "start": list(self.start),
            "goal": list(self.goal),
            "permeable": [[list(corner) for corner in polygon] for polygon in self.permeable],
            "impermeable": [[list(corner) for corner in polygon] for polygon in self.impermeable],
            **({"prices": list(self.prices)} if self.prices else {}),
        }


def _point(value: Any, field: str) -> tuple[float, float]:
    try:
        x, y = (float(v) for v in value)
    except (TypeError, ValueError):
        raise SceneError(f"{field} must be two numbers [x, y], got {value!r}") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise SceneError(f"{field} must be finite, got {value!r}")
    return x, y


def _polygons(value: Any, field: str) -> tuple[Corners, ...]:
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise SceneError(f"{field} must be a list of polygons, got {value!r}")
    polygons = []
    for i, corners in enumerate(value):
        if not isinstance(corners, Sequence) or isinstance(corners, str) or len(corners) < 3:
            raise SceneError(f"{field}[{i}] must be a list of at least 3 corners [x, y], got {corners!r}")
        polygons.append(tuple(_point(corner, f"{field}[{i}][{j}]") for j, corner in enumerate(corners)))
    return tuple(polygons)


def _prices(value: Any, count: int) -> tuple[float, ...]:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) not in (0, count):
        raise SceneError(f"prices must be {count} numbers, one for each permeable polygon, got {value!r}")
    for price in value:
        if not isinstance(price, (int, float)) or isinstance(price, bool) or not (math.isfinite(price) and price >= 0.0):
            raise SceneError(f"prices must be finite numbers from 0 on, got {price!r}")
    return tuple(float(price) for price in value)


def world_from_dict(data: Any, name: str = "wall") -> PlaneWorld:
    """Make a world from the contents of its JSON file.

    Args:
        data: an object with `map` {`lower` [x, y], `upper` [x, y]}, `start` [x, y], `goal` [x, y] and, both optional, `permeable`
            and `impermeable`: lists of polygons, a polygon being a list of corners [x, y]; `prices`, one number for each permeable
            polygon; `name` optional.
        name: used where the object has none.

    Raises:
        SceneError: names the field and what was expected; also where start or goal is outside of the map or in something impermeable.
    """
    if not isinstance(data, dict):
        raise SceneError(f"a wall must be a JSON object, got {type(data).__name__}")
    known = {"name", "map", "start", "goal", "permeable", "impermeable", "prices"}
    if unknown := sorted(set(data) - known):
        raise SceneError(f"unknown field {unknown[0]!r}; a wall has the fields {', '.join(sorted(known))}")
    for field in ("map", "start", "goal"):
        if field not in data:
            raise SceneError(f"the field {field!r} is missing")
    bounds = data["map"]
    if not isinstance(bounds, dict) or set(bounds) != {"lower", "upper"}:
        raise SceneError(f'map must be an object {{"lower": [x, y], "upper": [x, y]}}, got {bounds!r}')
    lower, upper = _point(bounds["lower"], "map.lower"), _point(bounds["upper"], "map.upper")
    if not (lower[0] < upper[0] and lower[1] < upper[1]):
        raise SceneError(f"map.lower {list(lower)} must be below map.upper {list(upper)} in x and in y")
    permeable = _polygons(data.get("permeable", []), "permeable")
    world = PlaneWorld(
        name=str(data.get("name", name)),
        lower=lower,
        upper=upper,
        start=_point(data["start"], "start"),
        goal=_point(data["goal"], "goal"),
        permeable=permeable,
        impermeable=_polygons(data.get("impermeable", []), "impermeable"),
        prices=_prices(data.get("prices", []), len(permeable)),
    )
    check_ends(world)
    return world


def check_ends(world: PlaneWorld) -> None:
    """Check that a search can begin and end: start and goal on the map, and in nothing impermeable (its outline is allowed).

    Raises:
        SceneError: names the field, the point and what it is in.
    """
    for field, point in (("start", world.start), ("goal", world.goal)):
        if not all(low <= v <= high for low, v, high in zip(world.lower, point, world.upper, strict=True)):
            raise SceneError(f"{field} {_text(point)} is outside of the map {_text(world.lower)} to {_text(world.upper)}")
        for i, corners in enumerate(world.impermeable):
            if is_inside(corners, point):
                raise SceneError(f"{field} {_text(point)} lies in impermeable[{i}]")


def _text(point: tuple[float, float]) -> str:
    return f"[{point[0]:g}, {point[1]:g}]"


def load_world(path: str | Path) -> PlaneWorld:
    """Read a world from a JSON file (see `world_from_dict`).

    Raises:
        SceneError: the file cannot be read, is not JSON, or a field is wrong; the text names file and field.
    """
    path = Path(path)
    try:
        data = read_json(path)
    except TextFileError as error:
        raise SceneError(f"cannot read the wall file {path}: {error}") from None
    try:
        return world_from_dict(data, name=path.stem)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


def wall_g() -> PlaneWorld:
    """Return geometry G, the wall fitted to the paper's table I: wide in the middle, narrow above and below.

    The wall is drawn 10 beyond the map, so that the map's edge is not one of its faces.
    """
    narrow, wide, low, high = 7.25, 10.25, -10.0, 110.0
    left = ((50 - narrow, low), (50 - narrow, 20.0), (50 - wide, 20.0), (50 - wide, 80.0), (50 - narrow, 80.0), (50 - narrow, high))
    right = tuple((100.0 - x, y) for x, y in reversed(left))
    return PlaneWorld("G", (0.0, 0.0), (100.0, 100.0), (10.0, 50.0), (90.0, 50.0), permeable=(left + right,))


def _leaf_wall(rng: np.random.Generator) -> list[Corners]:
    """A wall of leaves across the whole map, its faces zigzag, with thin places and sometimes an open gap off the straight line."""
    knots = np.concatenate([[-10.0], np.sort(rng.uniform(5.0, 95.0, size=int(rng.integers(5, 9)))), [110.0]])
    middle = 50.0 + rng.uniform(-6.0, 6.0, size=len(knots))
    half = rng.uniform(4.0, 12.0, size=len(knots))
    half[rng.choice(np.arange(1, len(knots) - 1), size=2, replace=False)] = rng.uniform(1.0, 3.0, size=2)
    faces = [[(float(middle[i] - half[i]), float(middle[i] + half[i]), float(knots[i])) for i in range(len(knots))]]
    if rng.random() < 0.5:
        gap = float(rng.choice([rng.uniform(8.0, 30.0), rng.uniform(70.0, 92.0)]))
        width = float(rng.uniform(2.0, 4.0))
        ends = []
        for y in (gap - width / 2.0, gap + width / 2.0):
            ends.append((float(np.interp(y, knots, middle - half)), float(np.interp(y, knots, middle + half)), y))
        below, above = [f for f in faces[0] if f[2] < ends[0][2]], [f for f in faces[0] if f[2] > ends[1][2]]
        faces = [[*below, ends[0]], [ends[1], *above]]
    return [tuple((left, y) for left, _, y in part) + tuple((right, y) for _, right, y in reversed(part)) for part in faces]


def _blocks(rng: np.random.Generator) -> list[Corners]:
    """Impermeable rectangles at any angle, so far apart that they never close the map, and a bar from its upper or lower edge."""
    height = float(rng.uniform(10.0, 30.0))
    x = float(rng.uniform(42.0, 58.0))
    low, high = (-10.0, height) if rng.random() < 0.5 else (100.0 - height, 110.0)
    blocks: list[Corners] = [((x - 3.0, low), (x + 3.0, low), (x + 3.0, high), (x - 3.0, high))]
    circles: list[tuple[float, float, float]] = []
    wanted = int(rng.integers(3, 6))
    for _ in range(200):
        if len(circles) == wanted:
            break
        a, b = rng.uniform(2.0, 5.0), rng.uniform(4.0, 11.0)
        radius = math.hypot(a, b)
        cx, cy, angle = rng.uniform(30.0, 70.0), rng.uniform(radius + 3.0, 97.0 - radius), rng.uniform(0.0, math.pi)
        gap_y = max(low - cy, 0.0, cy - high)
        if math.hypot(max(abs(cx - x) - 3.0, 0.0), gap_y) < radius + 3.0:
            continue
        if any(math.hypot(cx - ox, cy - oy) < radius + other + 3.0 for ox, oy, other in circles):
            continue
        circles.append((cx, cy, radius))
        c, s = math.cos(angle), math.sin(angle)
        corners = ((-a, -b), (a, -b), (a, b), (-a, b))
        blocks.append(tuple((float(cx + c * u - s * v), float(cy + s * u + c * v)) for u, v in corners))
    return blocks


def random_wall(seed: int) -> PlaneWorld:
    """Make a wall of another shape on the map of G: zigzag leaves with several gaps, and impermeable blocks in and around them.

    The same seed gives the same wall. A path always exists: the blocks keep 3 units between each other and from the map's edge.

    Raises:
        ProblemError: a negative seed.
    """
    if seed < 0:
        raise ProblemError(f"the seed of a wall must not be negative, got {seed}")
    rng = np.random.default_rng(seed)
    leaves, blocks = _leaf_wall(rng), _blocks(rng)
    return PlaneWorld(f"random {seed}", (0.0, 0.0), (100.0, 100.0), (10.0, 50.0), (90.0, 50.0), tuple(leaves), tuple(blocks))
