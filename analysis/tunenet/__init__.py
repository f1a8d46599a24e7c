"""TuneNet: the network that estimates a parameter residual from two observations."""
