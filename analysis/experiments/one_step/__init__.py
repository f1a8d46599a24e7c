"""Predictors of the next state, as Ajay et al. 2018 compare them: what the paper's table 3 quotes."""
