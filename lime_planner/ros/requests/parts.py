"""The parts of a planner node, as its requests, its services and its page are given them: typed, in one object, without the node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from rclpy.node import Node

from lime_planner.pipeline.result import PlanRecord
from lime_planner.ros.execution.execution import Execution
from lime_planner.ros.execution.stem_watch import StemWatch
from lime_planner.ros.inputs.frames import Frames
from lime_planner.ros.inputs.latest import Inputs, Target
from lime_planner.ros.inputs.scene_source import SceneSource
from lime_planner.ros.model_loader import ModelLoader
from lime_planner.ros.parameters import NodeParameters, Snapshot
from lime_planner.ros.requests.status_board import StatusBoard
from lime_planner.ros.requests.worker import Worker


@dataclass(frozen=True, eq=False)
class PlannedRequest:
    """A finished plan, and what its request was about.

    Attributes:
        record: the plan with what it was made of; its number counts the plans of the node.
        target: the target as it came in; None for a way back.
        snapshot: all parameters of the request.
        stem_number: which stem clouds the plan knows (`SceneSource.newest_stem_number`).
    """

    record: PlanRecord
    target: Target | None
    snapshot: Snapshot
    stem_number: int


class PlanDisplay(Protocol):
    """Shows every plan that was made: on topics, on the page."""

    def show(self, planned: PlannedRequest) -> None:
        """Take in a finished plan; must not wait for anything."""
        ...


@dataclass(frozen=True, eq=False)
class NodeParts:
    """What a planner node is made of.

    Attributes:
        node: for names, clock, services and setting parameters; nothing else.
        parameters: as they are set now.
        loader: robot model and pipeline.
        inputs: what has arrived.
        frames: where frames are.
        source: scenes of the newest clouds, for the model in use.
        execution: sends and stops motions.
        watch: checks a running motion against new stems.
        worker: the thread that plans.
        board: the status of every request.
        display: where finished plans are shown.
    """

    node: Node
    parameters: NodeParameters
    loader: ModelLoader
    inputs: Inputs
    frames: Frames
    source: SceneSource
    execution: Execution
    watch: StemWatch
    worker: Worker
    board: StatusBoard
    display: PlanDisplay
