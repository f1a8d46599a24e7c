"""Motion that has a formula, without an engine."""
