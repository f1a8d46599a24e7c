"""The review of a simulator that was tuned."""
