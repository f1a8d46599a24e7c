"""Experiments of `tunenet-eval`: run, measured against the truth, tabulated, exported."""
