"""Exports of motion capture: bodies and markers, in three dimensions."""
