"""The simulated world: vehicle, rope, capture, scenarios. No ROS, no clock, no logging."""
