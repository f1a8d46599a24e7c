"""Synthetic videos of falling balls, and what `tunenet-tune` makes of them."""
