"""Deliberate faults, and whether the test suite catches them."""
