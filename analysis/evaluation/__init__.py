"""Reproduce the paper's experiments: its tables and figures, beside ours."""
