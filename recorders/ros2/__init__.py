"""Record joint states and torques live from ROS 2, without a ROS installation."""
