"""Planning of a robot's bounce shot with a tuned ball."""
