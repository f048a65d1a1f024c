"""Grasps to choose from: tool poses at a target, configurations that hold them, and the straight stretches that lead there."""
