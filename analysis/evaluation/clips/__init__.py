"""Drawn clips of falling balls, frame by frame, and what `tunenet-tune` makes of them."""
