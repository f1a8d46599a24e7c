"""Estimators that tune a simulator to a target, all behind `Estimator`."""
