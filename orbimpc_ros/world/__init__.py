"""What the simulator simulates: vehicle, rope, capture, scenarios. No ROS, no clock, no logging."""
