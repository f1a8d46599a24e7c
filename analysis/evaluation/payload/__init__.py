"""First experiment: the mass in an arm's gripper, from its torques."""
