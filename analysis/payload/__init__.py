"""What an arm holds: all that knows it."""
