"""Predict motion, table 3: tuned simulators and one-step predictors of a ball's height."""
