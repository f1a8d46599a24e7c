"""Review of a payload in Rerun."""
