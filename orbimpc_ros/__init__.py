"""Convex model predictive control over rotations, as ROS 2 nodes."""
