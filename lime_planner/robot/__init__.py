"""The arm: model from a URDF, kinematics, inverse kinematics, and the exact collision check."""
