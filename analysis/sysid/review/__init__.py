"""Review of a tuned simulator in Rerun."""
