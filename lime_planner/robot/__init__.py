"""The arm: its model from a URDF, meshes, kinematics and inverse kinematics."""
