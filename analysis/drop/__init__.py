"""The bouncing ball: all that knows it."""
