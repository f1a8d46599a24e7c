"""Simulators: episode sources that can be rolled out again with other parameters."""
