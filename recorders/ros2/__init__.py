"""Joint states and torques, live from ROS 2 without a ROS installation, to a log."""
