"""The place of a target in a scene: what is hard there, and what is let go for the hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lime_planner.core.geometry import sphere_directions
from lime_planner.core.parameters import Settings
from lime_planner.core.types import Array, Float32
from lime_planner.scene.scene import Scene

STALK_LENGTH_M = 0.05  #: how far above a fruit's top its stalk is let go
_SHOWN_M = 0.05  # fruit points this close to a target show its fruit
_FEWEST = 8  # of such points that say how large it is
_SAME_M = 0.01  # between a target and a fruit of known centre
_SPACING_M = 0.004  # of the points of a fruit that the cloud does not show
_INTO_TOP_M = 0.002  # the stalk is let go from this far below the fruit's top
_ROOM_M = 0.02  # the approach zone reaches this far beyond the straight stretch
_SURFACE_M = 0.005  # points this far outside of a fruit's radius are still its surface
_LARGEST_M = 0.06  # radius of a fruit, where a cloud's points say more


@dataclass(frozen=True)
class Spot:
    """The place of a target, and what of the scene belongs to it.

    Attributes:
        centre: x y z [m], in the planning frame.
        fruit_radius_m: None for an exact pose: the fruit there is let go, and the exclusion sphere hides what is around it from the
            hand. Otherwise the fruit is hard, and only its stalk is let go for the hand: its radius, 0 where only the cloud's points
            count.
        stalk: whether a stalk is let go.
        picked: whether the hand has closed (on the way back): the fruit is let go with its stalk.
    """

    centre: tuple[float, float, float]
    fruit_radius_m: float | None = None
    stalk: bool = True
    picked: bool = False

    def is_fruit(self, place: Array) -> bool:
        """Whether a hard point (3,) is of the target's own fruit."""
        return self.fruit_radius_m is not None and float(np.linalg.norm(place - self.centre)) < self.fruit_radius_m + _SURFACE_M


def spot_at(place: Spot | npt.ArrayLike | None) -> Spot | None:
    """Return a spot as it is, a position (3,) as an exact pose's, and None as it is."""
    if place is None or isinstance(place, Spot):
        return place
    x, y, z = (float(v) for v in np.asarray(place, dtype=np.float64))
    return Spot((x, y, z))


def shown_radius_m(scene: Scene, centre: Array) -> float | None:
    """Return the radius of the fruit that a scene shows at a place (3,), None where it shows none [m].

    That is the known radius on a generated plant; in a cloud, the median distance of the fruit points near the place.
    """
    if scene.fruit_centres is not None and scene.fruit_radii is not None and len(scene.fruit_centres):
        apart = np.linalg.norm(scene.fruit_centres - centre, axis=1)
        if apart.min() < _SAME_M:
            return float(scene.fruit_radii[int(apart.argmin())])
    away = np.linalg.norm(scene.fruit_points - centre, axis=1) if len(scene.fruit_points) else np.zeros(0)
    near = away[away < _SHOWN_M]
    return min(float(np.median(near)), _LARGEST_M) if len(near) >= _FEWEST else None


def ball(centre: npt.ArrayLike, radius_m: float) -> Float32:
    """Return points (P, 3) spread evenly over a sphere, about 4 mm apart [m]."""
    count = max(12, int(4.0 * np.pi * (radius_m / _SPACING_M) ** 2))
    return np.asarray(np.asarray(centre, dtype=np.float64) + radius_m * sphere_directions(count), dtype=np.float32)


def hard_points(scene: Scene, spot: Spot | None, settings: Settings) -> Float32:
    """Return every point that the arm must not touch, (P, 3) [m]."""
    if spot is None:
        return scene.impermeable_points(None, 0.0)
    centre = np.array(spot.centre)
    if spot.fruit_radius_m is None or spot.picked:
        return scene.impermeable_points(centre, settings.target_exclusion_radius_m)
    points = scene.impermeable_points(None, 0.0)
    # The cloud shows one side of a fruit, or nothing of it: the whole of it is hard. The points' own radius reaches the surface.
    inner_m = spot.fruit_radius_m - settings.stem_point_radius_m
    return points if inner_m <= 0.0 else np.concatenate([points, ball(centre, inner_m)])


def exclusion(spot: Spot | None, settings: Settings) -> tuple[Array, float]:
    """Return what does not block the hand (`World.exclusion`, (6,)), and how near to the spot the tool must be for that [m]."""
    values = np.zeros(6)
    if spot is None:
        return values, settings.approach_zone_m
    values[:3] = spot.centre
    if spot.fruit_radius_m is None:
        values[3] = settings.target_exclusion_radius_m
        return values, settings.approach_zone_m
    zone_m = max(settings.approach_zone_m, settings.approach_distance_m + _ROOM_M)
    if spot.stalk and settings.stalk_radius_m > 0.0:
        values[3] = settings.stalk_radius_m
        # The ends of the segment are round: the lower one begins at the fruit's top, the upper one ends at the stalk's end.
        values[4] = spot.fruit_radius_m + settings.stalk_radius_m - _INTO_TOP_M
        values[5] = max(values[4], spot.fruit_radius_m + STALK_LENGTH_M - settings.stalk_radius_m)
    return values, zone_m


def spared(points: npt.NDArray[np.floating], exclusion_: Array) -> npt.NDArray[np.bool_]:
    """Tell which points (P, 3) an exclusion (6,) hides from the hand, (P,)."""
    offset = np.asarray(points, dtype=np.float64) - exclusion_[:3]
    offset[:, 2] -= np.clip(offset[:, 2], exclusion_[4], exclusion_[5])
    return np.asarray((offset**2).sum(axis=1) < exclusion_[3] ** 2)
