"""Inject deliberate faults to see whether the test suite catches them."""
