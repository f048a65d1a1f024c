"""From the newest clouds to one immutable scene in the planning frame; runs in the worker."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from std_msgs.msg import Header

from lime_planner.core.errors import Refusal, SceneError
from lime_planner.core.geometry import clean_name
from lime_planner.core.parameters import NodeSettings
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.targets import Target as Aim
from lime_planner.ros.inputs.arm_camera import ArmCamera
from lime_planner.ros.inputs.frames import Frames
from lime_planner.ros.inputs.known_views import KnownViews
from lime_planner.ros.inputs.latest import Inputs, Sample, Target, input_of
from lime_planner.ros.inputs.placement import Placements
from lime_planner.ros.inputs.view_memory import ViewMemory, Waiting, taken_s
from lime_planner.ros.parameters import Snapshot
from lime_planner.scene.from_clouds import CLOUDS, ArmFilter, Labels, Origins, belonging_together, one_picture, scene_of_cloud, without_arm
from lime_planner.scene.scene import Scene

#: Scenes of clouds of one input that are kept: the newest one, and those that the watch over a motion looked at.
_PARTS_KEPT = 6
#: Leaf and stem clouds of one frame taken within this are one picture [s].
_ONE_PICTURE_S = 0.05


@dataclass(frozen=True)
class _Key:
    """What a cloud's scene was made of: the same cloud and settings need no second look."""

    number: int
    labels: Labels
    origins: Origins
    padding_m: float
    arm: tuple[float, ...] | None
    moved: bytes | None


class SceneSource:
    """Makes scenes of the inputs and keeps the last ones."""

    def __init__(self, inputs: Inputs, frames: Frames, planning_frame: str, arm_filter: ArmFilter, *, fixed_frame: str = "") -> None:
        """Make a source.

        Args:
            inputs: where the clouds arrive.
            frames: where their frames are.
            planning_frame: frame of the scenes.
            arm_filter: removes the arm's own points.
            fixed_frame: the frame in which clouds stay while the base moves; empty for the planning frame.
        """
        self._inputs = inputs
        self.placements = Placements(frames, planning_frame, fixed_frame)
        self._planning_frame = planning_frame
        self._arm_filter = arm_filter
        self._parts: dict[str, OrderedDict[int, tuple[_Key, Scene]]] = {}
        self._merged: tuple[list[Scene], Scene] | None = None
        self.camera: ArmCamera | None = None
        self._memory = ViewMemory()
        self._heard: dict[tuple[str, str], float] = {}  # when the newest cloud of each input and frame was taken
        self._views = KnownViews()
        self.memory_s = 60.0
        self._lock = threading.Lock()  # the worker and the execution watch ask

    def use_arm(self, planning_frame: str, arm_filter: ArmFilter, camera: ArmCamera | None = None) -> None:
        """Make scenes for another arm from now on.

        Args:
            planning_frame: frame of the scenes.
            arm_filter: removes the arm's own points.
            camera: that it carries.
        """
        with self._lock:
            self._planning_frame, self._arm_filter, self.camera = planning_frame, arm_filter, camera
            self._parts, self._merged = {}, None
            self._memory.clear()
            self._views.clear()
            self.placements.use_planning_frame(planning_frame)

    def arrived(self, name: str) -> None:
        """Note where the newest message of an input was, while its transforms are known."""
        sample = self._inputs.slots[name].newest
        if sample is None or sample.refusal is not None:
            return
        frame = clean_name(sample.msg.header.frame_id)
        if name in CLOUDS:
            self._heard[name, frame] = taken_s(sample)
        carried = self._carries(frame)
        self.placements.arrived(name, sample.number, sample.msg.header if carried is None else self._at_base(sample))
        if name not in CLOUDS or not sample.msg.width * sample.msg.height:
            return
        q = None if carried is None else self._inputs.arm_at_clouds.at(name, sample.number)
        T = self.placements.noted(name, sample.number) if carried is None or q is None else carried(q)
        self._memory.arrived(Waiting(name, sample, frame, T, taken_s(sample)), self.memory_s)
        self._remember()

    def _remember(self) -> None:
        """Have placements and joints kept of the clouds that may still be asked about."""
        for name in CLOUDS:
            used = frozenset(cloud.sample.number for cloud in (*self._memory.waiting(), *self._views.clouds()) if cloud.name == name)
            self._inputs.arm_at_clouds.remember(name, used)
            self.placements.remember(name, used)

    def _carries(self, frame: str) -> Callable[[Array], Array] | None:
        return None if self.camera is None else self.camera.carries(frame)

    def _at_base(self, sample: Sample) -> Header:
        """The header of what the arm's base carries: it moves as the planning frame does."""
        return Header(stamp=sample.msg.header.stamp, frame_id=self._planning_frame)

    def seen_by_arm_since(self, moment_s: float) -> bool:
        """Tell whether the arm's camera has taken a picture since a moment [s, monotonic]: stems, and leaves where it sends them."""
        heard = {key: at_s for key, at_s in list(self._heard.items()) if self._carries(key[1])}
        frames = {frame for name, frame in heard if name != "leaf_cloud"}
        for frame in frames:
            labelled = heard.get(("labelled_cloud", frame), -np.inf)
            pair = min(heard.get(("stem_cloud", frame), -np.inf), heard.get(("leaf_cloud", frame), np.inf))
            if max(labelled, pair) >= moment_s and max(labelled, pair) > -np.inf:
                return True
        return False

    def goal(self, target: Target, snapshot: Snapshot, should_stop: Callable[[], bool]) -> Aim:
        """Return what a target asks for, in the planning frame, where it is now.

        Raises:
            Refusal: TF_ERROR; STALE_INPUT, the base moved since its stamp and there is no fixed frame.
        """
        number = None if target.sample is None else target.sample.number
        T_planning_data, T_now_then = self.placements.place(input_of(target.msg), number, target.msg.header, snapshot.node, should_stop)
        return target.aim.moved(T_planning_data if T_now_then is None else T_now_then @ T_planning_data)

    def newest_stem_number(self) -> int:
        """Return a number that changes whenever a cloud with stems arrives."""
        return sum(self._inputs.slots[name].received for name in ("stem_cloud", "labelled_cloud"))

    def scene(self, snapshot: Snapshot, should_stop: Callable[[], bool]) -> Scene:
        """Return the scene of the newest clouds.

        Raises:
            Refusal: NO_CLOUD, BAD_INPUT, STALE_INPUT, TF_ERROR; CANCELLED when it should stop.
        """
        with self._lock:
            samples = self._samples(snapshot.node)
            scene = self._scene(samples, snapshot, should_stop)
            for name, sample in samples.items():
                self._inputs.slots[name].use(sample)
            if snapshot.node.fuse_views:
                scene = self._with_earlier(samples, scene, snapshot, should_stop)
        _refuse_emptiness(samples, scene, snapshot.node)
        return scene

    def _with_earlier(self, samples: dict[str, Sample], newest: Scene, snapshot: Snapshot, should_stop: Callable[[], bool]) -> Scene:
        """Return what the newest clouds show together with what earlier ones did; the newest alone where its viewpoint is not known."""
        node = snapshot.node
        if newest.viewpoints is None and newest.n_points:
            return newest
        own = {(name, sample.number) for name, sample in samples.items()}
        waiting = [cloud for cloud in self._memory.waiting() if (cloud.name, cloud.sample.number) not in own]
        for picture in _pictures(waiting):
            try:
                parts = [self._part(cloud.name, cloud.sample, snapshot, should_stop) for cloud in picture]
                scene = one_picture(parts, self._planning_frame)
                if scene.viewpoints is not None:
                    self._views.add(scene, picture[-1], self._moved_since(picture[-1], node, should_stop))
            except Refusal as refusal:
                if refusal.status is Status.CANCELLED:
                    raise
                self._inputs.warn(f"an earlier cloud of {picture[-1].name} is left out: {refusal}")
            for cloud in picture:
                self._memory.use(cloud)
        self._views.forget(time.monotonic() - node.view_memory_s)
        self._views.move(lambda cloud: self._moved_since(cloud, node, should_stop))
        self._remember()
        return self._views.with_newest(newest, max((taken_s(sample) for sample in samples.values()), default=time.monotonic()))

    def _moved_since(self, cloud: Waiting, node: NodeSettings, should_stop: Callable[[], bool]) -> Array | None:
        header = cloud.sample.msg.header if self._carries(cloud.frame) is None else self._at_base(cloud.sample)
        return self.placements.place(cloud.name, cloud.sample.number, header, node, should_stop)[1]

    def changed_stems(self, number: int, snapshot: Snapshot, should_stop: Callable[[], bool]) -> Scene | None:
        """Return the newest stems if any came after a scene was made, else None, the newest clouds' ages checked once more.

        Args:
            number: `newest_stem_number` before the scene was made.
            snapshot: the parameters.
            should_stop: ends a wait early.

        Raises:
            Refusal: see `scene`; an empty cloud is NO_CLOUD here too.
        """
        if self.newest_stem_number() == number:
            for name, sample in self._samples(snapshot.node).items():
                sample.check_time(name, snapshot.node.max_cloud_age_s, snapshot.node.max_clock_skew_s)
            return None
        scene = self.stems(snapshot, should_stop)
        if not snapshot.node.fuse_views or scene.viewpoints is None:  # else stems are known from other views
            _refuse_emptiness(("the stem cloud that came while planning",), scene, snapshot.node)
        return scene

    def stems(self, snapshot: Snapshot, should_stop: Callable[[], bool], settle_s: float = 0.0) -> Scene:
        """Return the scene of the newest stems alone, for the watch over a motion; the leaf cloud is left for the next plan.

        Args:
            snapshot: the parameters.
            should_stop: ends a wait early.
            settle_s: how long to wait at most for the joint states that tell where a moving arm stood at the cloud's stamp [s]; before
                that its own points would be looked for in a wrong place.

        Raises:
            Refusal: see `scene`.
        """
        samples = self._samples(snapshot.node)
        samples.pop("leaf_cloud", None)
        deadline_s = time.monotonic() + settle_s
        while not all(self._inputs.arm_at_clouds.settled(name, sample.number) for name, sample in samples.items()):
            if time.monotonic() >= deadline_s or should_stop():
                break
            time.sleep(0.005)
        with self._lock:
            scene = self._scene(samples, snapshot, should_stop)
            for name, sample in samples.items():
                self._inputs.slots[name].use(sample)
            return scene

    def _scene(self, samples: dict[str, Sample], snapshot: Snapshot, should_stop: Callable[[], bool]) -> Scene:
        for name, sample in samples.items():
            if sample.refusal is not None:
                raise Refusal(Status.BAD_INPUT, sample.refusal)
            sample.check_time(name, snapshot.node.max_cloud_age_s, snapshot.node.max_clock_skew_s)
        self._check_skew(samples, snapshot.node.max_cloud_skew_s)
        parts = [self._part(name, sample, snapshot, should_stop) for name, sample in samples.items()]
        if len(parts) == 1:
            return parts[0]
        if (
            self._merged is None
            or len(self._merged[0]) != len(parts)
            or any(a is not b for a, b in zip(self._merged[0], parts, strict=True))
        ):
            self._merged = (parts, one_picture(parts, self._planning_frame))
        return self._merged[1]

    def _samples(self, node: NodeSettings) -> dict[str, Sample]:
        """Return the newest clouds that belong together: the labelled one, or leaf and stem, whichever came last."""
        newest = {name: self._inputs.slots[name].newest for name in CLOUDS}
        there = {name: sample for name, sample in newest.items() if sample is not None}
        names = belonging_together({name: sample.arrival_s for name, sample in there.items()})
        if not {"stem_cloud", "labelled_cloud"} & set(names) and not node.allow_empty_stem_cloud:
            raise Refusal(Status.NO_CLOUD, "no stem cloud has been received (allow_empty_stem_cloud permits motion without)")
        return {name: there[name] for name in names}

    def _check_skew(self, samples: dict[str, Sample], limit_s: float) -> None:
        if limit_s <= 0.0 or not {"leaf_cloud", "stem_cloud"} <= samples.keys():
            return
        leaf, stem = samples["leaf_cloud"], samples["stem_cloud"]
        stamped = leaf.stamp_s > 0.0 and stem.stamp_s > 0.0
        skew_s = abs(leaf.stamp_s - stem.stamp_s) if stamped else abs(leaf.arrival_s - stem.arrival_s)
        if skew_s > limit_s:
            raise Refusal(Status.STALE_INPUT, f"leaf and stem cloud are {skew_s:.2f} s apart, the limit is {limit_s:g} s")

    def _part(self, name: str, sample: Sample, snapshot: Snapshot, should_stop: Callable[[], bool]) -> Scene:
        """Return one cloud's scene: the same object again as long as cloud and settings are the same."""
        node = snapshot.node
        labels = Labels(node.label_field, node.leaf_labels, node.stem_labels, node.fruit_labels, node.ignored_labels, node.class_costs)
        origins = Origins(node.viewpoints, node.fixed_frame)
        T_planning_data: Array | None = None
        T_now_then: Array | None = None
        q = self._inputs.arm_at_clouds.at(name, sample.number)  # may be known better than at the last look
        if sample.msg.width * sample.msg.height:  # an empty cloud is nowhere
            carried = self._carries(sample.msg.header.frame_id)
            header = sample.msg.header if carried is None else self._at_base(sample)
            T_planning_data, T_now_then = self.placements.place(name, sample.number, header, node, should_stop)
            if carried is not None:
                if q is None:
                    raise Refusal(
                        Status.TF_ERROR, f"{name}: where the arm carried {sample.msg.header.frame_id!r} at its stamp is not known"
                    )
                T_planning_data = carried(q)
        moved = None if T_now_then is None else T_now_then.tobytes()
        key = _Key(sample.number, labels, origins, snapshot.plan.self_filter_padding_m, None if q is None else tuple(q), moved)
        kept = self._parts.setdefault(name, OrderedDict())
        known = kept.get(sample.number)
        if known is not None and known[0] == key:
            return known[1]
        try:
            frame, between = self._planning_frame, lambda: _ask(should_stop)
            scene = scene_of_cloud(sample.msg, name, labels, frame, lambda _: T_planning_data, origins=origins, between=between)
            part = without_arm(scene, self._arm_filter, q, key.padding_m, T_now_then)
        except SceneError as error:
            self._inputs.slots[name].reject(sample, str(error))
            raise Refusal(Status.BAD_INPUT, str(error)) from None
        kept[sample.number] = (key, part)
        while len(kept) > _PARTS_KEPT:
            kept.popitem(last=False)
        for note in part.notes:
            self._inputs.warn(note)
        return part


def _pictures(clouds: Sequence[Waiting]) -> list[list[Waiting]]:
    """Put clouds (in the order in which they were taken) together that are parts of one picture: leaves and stems of one camera."""
    pictures: list[list[Waiting]] = []
    for cloud in clouds:
        partner = next((p for p in pictures if p[0].frame == cloud.frame and _belong_together(p, cloud)), None)
        if partner is None:
            pictures.append([cloud])
        else:
            partner.append(cloud)
    return pictures


def _belong_together(picture: list[Waiting], cloud: Waiting) -> bool:
    names = {other.name for other in picture}
    one = cloud.name not in names and "labelled_cloud" not in (*names, cloud.name)
    return one and abs(picture[0].taken_s - cloud.taken_s) < _ONE_PICTURE_S


def _ask(should_stop: Callable[[], bool]) -> None:
    if should_stop():
        raise Refusal(Status.CANCELLED, "the request was stopped")


def _refuse_emptiness(names: Iterable[str], scene: Scene, node: NodeSettings) -> None:
    # Fruit does not count: the lime to be picked is in view whatever the segmentation made of the stems, and is spared as the target.
    if len(scene.stem_points) or node.allow_empty_stem_cloud:
        return
    received, gone = scene.counts.get("received", 0), scene.counts.get("non_finite", 0)
    sentence = f"no stem point among the {received} points of {' and '.join(names) or 'no cloud'} ({gone} not finite)"
    raise Refusal(Status.NO_CLOUD, f"{sentence}; allow_empty_stem_cloud permits motion without")
