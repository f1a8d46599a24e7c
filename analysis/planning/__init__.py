"""What a tuned ball is for: the shot that a robot is to take."""
