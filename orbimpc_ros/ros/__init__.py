"""ROS 2 adapters: messages and parameters to plain types and back, and the two nodes."""
