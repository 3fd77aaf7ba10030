"""The Cessna of JSBSim: ros2 launch orbimpc_ros cessna.launch.py."""

from orbimpc_ros.ros.launching import flight


def generate_launch_description():
    """Return both nodes on one parameter file."""
    return flight('cessna')
