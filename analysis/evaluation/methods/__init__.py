"""Methods that only the experiments compare."""
