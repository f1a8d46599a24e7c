"""A drop by its impact times alone."""
