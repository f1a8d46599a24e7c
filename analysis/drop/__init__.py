"""The bouncing-ball experiments."""
