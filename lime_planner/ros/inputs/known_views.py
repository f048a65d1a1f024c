"""What the clouds of all cameras showed in the last minute or so, in the planning frame as it is now; for the worker."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lime_planner.core.errors import Refusal
from lime_planner.core.types import Array
from lime_planner.ros.inputs.view_memory import Waiting
from lime_planner.scene.scene import Scene
from lime_planner.scene.views.fused import Picture, add_picture, fused

FROM_ONE_PLACE = 2  #: pictures of a camera from one place: the newest, and one before something may have hidden the plant
MOST_PICTURES = 16  #: beyond that the oldest of the camera with most of them goes: each takes some hundredths of a second in every plan

#: Where the planning frame of a cloud's stamp is in that of now, (4, 4); None where it has not moved. Raises Refusal where nothing tells.
Moved = Callable[[Waiting], Array | None]


@dataclass(frozen=True, eq=False)
class _Known:
    """A picture, and the cloud whose stamp says where its planning frame was.

    Attributes:
        picture: in the planning frame of `T_now_then`.
        cloud: one of its clouds.
        T_now_then: (4, 4) that it was moved by last; None for not at all.
    """

    picture: Picture
    cloud: Waiting
    T_now_then: Array | None


class KnownViews:
    """Pictures, oldest first, each without what later ones saw through."""

    def __init__(self) -> None:
        """Start with nothing."""
        self._known: list[_Known] = []
        self._made: tuple[tuple[object, ...], Scene] | None = None

    def clear(self) -> None:
        """Forget everything."""
        self._known, self._made = [], None

    def clouds(self) -> list[Waiting]:
        """Return the clouds whose placements are still asked for."""
        return [known.cloud for known in self._known]

    def add(self, scene: Scene, cloud: Waiting, T_now_then: Array | None) -> None:
        """Take in one more picture of known viewpoint."""
        newer = _Known(Picture(scene, cloud.taken_s), cloud, T_now_then)
        pictures = add_picture([known.picture for known in self._known], newer.picture)
        place = sum(known.picture.taken_s <= cloud.taken_s for known in self._known)
        whole = [*self._known[:place], newer, *self._known[place:]]
        self._known = [dataclasses.replace(known, picture=picture) for known, picture in zip(whole, pictures, strict=True)]
        alike = [known for known in self._known if known.cloud.frame == cloud.frame and known.cloud.near(cloud)]
        for known in alike[:-FROM_ONE_PLACE]:
            self._known.remove(known)
        while len(self._known) > MOST_PICTURES:
            frames = [known.cloud.frame for known in self._known]
            del self._known[frames.index(max(frames, key=frames.count))]

    def forget(self, before_s: float) -> None:
        """Forget pictures taken before a time [s]."""
        self._known = [known for known in self._known if known.picture.taken_s >= before_s]

    def move(self, T_now_then: Moved) -> None:
        """Bring every picture to where the planning frame is now; those of which nothing tells how far it has moved are forgotten."""
        kept = []
        for known in self._known:
            try:
                now = T_now_then(known.cloud)
            except Refusal:
                continue
            a, b = (np.eye(4) if T is None else T for T in (now, known.T_now_then))
            if not np.allclose(a, b, atol=1e-5):
                scene = known.picture.scene.transformed(a @ np.linalg.inv(b))
                known = dataclasses.replace(known, picture=dataclasses.replace(known.picture, scene=scene), T_now_then=now)
            kept.append(known)
        self._known = kept

    def with_newest(self, scene: Scene, taken_s: float) -> Scene:
        """Return what is known together with the newest picture; the same object again as long as nothing has changed."""
        key = (scene, *(known.picture for known in self._known))
        if self._made is None or len(self._made[0]) != len(key) or any(a is not b for a, b in zip(self._made[0], key, strict=True)):
            pictures = add_picture([known.picture for known in self._known if known.picture.scene is not scene], Picture(scene, taken_s))
            self._made = (key, fused(pictures, scene.frame_id))
        return self._made[1]
