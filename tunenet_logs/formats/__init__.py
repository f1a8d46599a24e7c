"""Readers of log formats: one file per container or message encoding."""
