"""From the newest clouds to one immutable scene in the planning frame; runs in the worker."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from lime_planner.core.errors import Refusal, SceneError
from lime_planner.core.parameters import NodeSettings
from lime_planner.core.status import Status
from lime_planner.core.types import Array
from lime_planner.pipeline.targets import Target as Aim
from lime_planner.ros.inputs.frames import Frames
from lime_planner.ros.inputs.latest import Inputs, Sample, Target, input_of
from lime_planner.ros.inputs.placement import Placements
from lime_planner.ros.parameters import Snapshot
from lime_planner.scene.from_clouds import CLOUDS, ArmFilter, Labels, belonging_together, scene_of_cloud, without_arm
from lime_planner.scene.scene import Scene, merged


@dataclass(frozen=True)
class _Key:
    """What a cloud's scene was made of: the same cloud and settings need no second look."""

    number: int
    labels: Labels
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
        self._parts: dict[str, tuple[_Key, Scene]] = {}
        self._merged: tuple[list[Scene], Scene] | None = None
        self._lock = threading.Lock()  # the worker and the execution watch ask

    def use_arm(self, planning_frame: str, arm_filter: ArmFilter) -> None:
        """Make scenes for another arm from now on.

        Args:
            planning_frame: frame of the scenes.
            arm_filter: removes the arm's own points.
        """
        with self._lock:
            self._planning_frame, self._arm_filter = planning_frame, arm_filter
            self._parts, self._merged = {}, None
            self.placements.use_planning_frame(planning_frame)

    def arrived(self, name: str) -> None:
        """Note where the newest message of an input was, while its transforms are known."""
        sample = self._inputs.slots[name].newest
        if sample is not None and sample.refusal is None:
            self.placements.arrived(name, sample.number, sample.msg.header)

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
        _refuse_emptiness(samples, scene, snapshot.node)
        return scene

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
        parts = [self._kept_part(name, sample, snapshot, should_stop) for name, sample in samples.items()]
        if len(parts) == 1:
            return parts[0]
        if (
            self._merged is None
            or len(self._merged[0]) != len(parts)
            or any(a is not b for a, b in zip(self._merged[0], parts, strict=True))
        ):
            self._merged = (parts, merged(parts, self._planning_frame))
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

    def _kept_part(self, name: str, sample: Sample, snapshot: Snapshot, should_stop: Callable[[], bool]) -> Scene:
        """Return one cloud's scene: the same object again as long as cloud and settings are the same."""
        node = snapshot.node
        labels = Labels(node.label_field, node.leaf_labels, node.stem_labels, node.fruit_labels, node.ignored_labels, node.class_costs)
        T_planning_data: Array | None = None
        T_now_then: Array | None = None
        if sample.msg.width * sample.msg.height:  # an empty cloud is nowhere
            T_planning_data, T_now_then = self.placements.place(name, sample.number, sample.msg.header, node, should_stop)
        q = self._inputs.arm_at_clouds.at(name, sample.number)  # may be known better than at the last look
        moved = None if T_now_then is None else T_now_then.tobytes()
        key = _Key(sample.number, labels, snapshot.plan.self_filter_padding_m, None if q is None else tuple(q), moved)
        kept = self._parts.get(name)
        if kept is not None and kept[0] == key:
            return kept[1]
        try:
            frame, between = self._planning_frame, lambda: _ask(should_stop)
            scene = scene_of_cloud(sample.msg, name, labels, frame, lambda _: T_planning_data, between=between)
            part = without_arm(scene, self._arm_filter, q, key.padding_m, T_now_then)
        except SceneError as error:
            self._inputs.slots[name].reject(sample, str(error))
            raise Refusal(Status.BAD_INPUT, str(error)) from None
        self._parts[name] = (key, part)
        for note in part.notes:
            self._inputs.warn(note)
        return part


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
