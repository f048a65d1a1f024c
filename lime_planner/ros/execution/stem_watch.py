"""Looks at every new stem cloud while a motion runs: does a stem stand on what remains of the path?

In a thread of its own, because a preview may keep the worker busy meanwhile. Leaves that move never stop a motion.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable

from lime_planner.core.errors import Refusal
from lime_planner.core.status import Status
from lime_planner.ros.execution.execution import Execution
from lime_planner.ros.execution.motion import Motion
from lime_planner.ros.inputs.scene_source import SceneSource
from lime_planner.ros.model_loader import ModelLoader
from lime_planner.ros.runtime import BackgroundThread

#: Pause after each look [s]: clouds come faster than they need be looked at, and callbacks want the interpreter too.
_PAUSE_S = 0.05

#: How long a look waits for the joint states of a cloud's stamp [s]: Kinova's driver sends ten a second, some of them late.
_SETTLE_S = 0.15

#: What looks: (motion, should_stop) -> a sentence when the way is blocked, else None. May raise `Refusal`.
Look = Callable[[Motion, Callable[[], bool]], str | None]


class StemWatch(BackgroundThread):
    """The thread."""

    def __init__(self, execution: Execution, look: Look, warn: Callable[[str], None]) -> None:
        """Start watching.

        Args:
            execution: tells which motion runs and stops it.
            look: checks the remaining path against the newest clouds.
            warn: is told about clouds that cannot be used and about defects.
        """
        super().__init__("stem watch")
        self._execution = execution
        self._look = look
        self._warn = warn
        self._due = False
        self._start()

    def notice(self) -> None:
        """Say that a cloud with stems has arrived."""
        with self._condition:
            self._due = True
            self._condition.notify_all()

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._due or self._closed)
                self._due = False
                if self._closed:
                    return
            motion = self._execution.motion
            if motion is not None:
                self._check(motion)
                time.sleep(_PAUSE_S)

    def _check(self, motion: Motion) -> None:
        def should_stop() -> bool:
            return self._closed or self._execution.motion is not motion

        try:
            sentence = self._look(motion, should_stop)
        except Refusal as refusal:
            if not should_stop():
                self._warn(f"during the motion of plan {motion.plan_id}: {refusal}")
            return
        except Exception:  # the watch must outlive a defect: without it the next motion would run unwatched
            self._warn(traceback.format_exc())
            return
        if sentence is not None and self._execution.motion is motion:
            self._execution.stop(Status.STEM_APPEARED, sentence)


def make_look(source: SceneSource, loader: ModelLoader, execution: Execution) -> Look:
    """Make the usual look: newest scene, pipeline's check of the remaining trajectory.

    Args:
        source: of scenes.
        loader: of the model in use.
        execution: tells how far on its plan the arm is.
    """

    def look(motion: Motion, should_stop: Callable[[], bool]) -> str | None:
        loaded = loader.loaded
        if loaded is None:
            return None
        scene = source.stems(motion.snapshot, should_stop, _SETTLE_S)
        reached_s = execution.reached_s(motion)
        return loaded.pipeline.obstruction(motion.result, scene, motion.snapshot.plan, from_time_s=reached_s, should_stop=should_stop)

    return look
