"""Second experiment: the restitution of a bouncing ball, every method, rollout by rollout."""
