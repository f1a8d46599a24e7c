"""Sources of episodes: cameras, microphones, ROS 2 topics and simulators."""
