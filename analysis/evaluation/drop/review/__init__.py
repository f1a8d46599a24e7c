"""The experiments' figures for Rerun."""
