"""Episode -> Observation: what of an episode is compared, in units that make rigs alike."""
