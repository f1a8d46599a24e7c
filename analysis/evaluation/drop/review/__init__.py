"""Export the experiments' figures to Rerun."""
