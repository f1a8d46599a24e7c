"""The commands that tune, train and review. Parsing here; the work is in functions elsewhere."""
