"""Tables that controllers of robots record."""
