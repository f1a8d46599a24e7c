"""Predict the next state (Ajay et al. 2018), as the paper's table 3 quotes."""
