"""Third experiment in simulation: drop, tune, plan, and shoot in a hidden world."""
