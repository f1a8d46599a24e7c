"""Offline analysis: experiments, estimators, results and their review."""
