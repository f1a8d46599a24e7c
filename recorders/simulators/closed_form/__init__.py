"""Motion in closed form, without an engine."""
