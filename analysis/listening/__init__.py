"""Onset detection in sound."""
