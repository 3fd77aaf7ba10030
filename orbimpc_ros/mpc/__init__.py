"""The mathematics: orbitope MPC in NumPy, CVXPY and Clarabel. No ROS, no clock, no logging."""
