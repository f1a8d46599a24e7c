"""The network that estimates a parameter residual from two observations, and its training."""
