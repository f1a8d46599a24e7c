"""The review of a payload."""
