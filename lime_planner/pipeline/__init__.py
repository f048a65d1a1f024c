"""The one way from a scene and a target to a motion: node, command line, experiments and tests all go through here."""

from lime_planner.pipeline.pipeline import Pipeline
from lime_planner.pipeline.result import PlanResult

__all__ = ["Pipeline", "PlanResult"]
