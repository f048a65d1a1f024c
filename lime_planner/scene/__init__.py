"""What stands in front of the arm: scenes, their files and recordings, cleaning, and the generator of lime plants."""

from __future__ import annotations

from lime_planner.scene.scene import DEFAULT_FRAME, FRUIT, LEAF, STEM, Scene

__all__ = ["DEFAULT_FRAME", "FRUIT", "LEAF", "STEM", "Scene"]
