"""The outcomes of planning and of motion, as codes that users and messages share."""

from __future__ import annotations

import enum


class Status(enum.Enum):
    """Outcome codes; the value is what the code means, in words."""

    SUCCEEDED = "the target is reached by a certified path"
    NO_TARGET = "no grasp target has been received"
    NO_CLOUD = "no stem cloud has been received, or it is empty"
    NO_JOINT_STATE = "no joint state has been received"
    STALE_INPUT = "an input is older than its limit"
    BAD_INPUT = "an input cannot be used"
    TF_ERROR = "the transform between two frames is not known"
    START_INVALID = "the measured configuration is out of limits or in collision with the arm itself or a keep-out"
    START_IN_STEM = "the arm touches a stem where it stands"
    NO_IK_SOLUTION = "no configuration within the limits reaches the target"
    GOAL_IN_STEM = "every configuration that reaches the target touches a stem or a keep-out"
    NO_PATH = "no path was found within the iteration budget"
    TIMED_OUT = "no path was found within the time budget"
    LEAF_BUDGET_EXCEEDED = "every path found touches more leaves than allowed"
    UNSEEN = "every path found leads through more space that no camera has seen than allowed"
    PATH_INVALID = "the exact check or the trajectory contract refused the path"
    PREEMPTED = "a newer request took over"
    CANCELLED = "the request was stopped"
    STEM_APPEARED = "a newer cloud has a stem on the rest of the path"
    EXECUTION_DEVIATED = "the arm left the planned motion"
    NOTHING_TO_EXECUTE = "there is no previewed plan"
    ARM_MOVING = "the arm did not come to rest in time"
    NO_CONTROLLER = "no controller takes the motion"
    MOTION_DISABLED = "motion is disabled by motion_enabled"
    NOT_READY = "the node is still warming up"
    NOT_INSTALLED = "an optional library that this needs is not installed"
    INTERNAL_ERROR = "a defect in this software"

    def message(self, sentence: str) -> str:
        """Return `CODE: sentence`, the form of every service answer."""
        return f"{self.name}: {sentence}"
