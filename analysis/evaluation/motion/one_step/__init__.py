"""Predictors of the next state (Ajay et al. 2018), which the paper's table 3 quotes."""
