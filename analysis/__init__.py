"""What an episode means: observations, estimators, tunings and their review."""
