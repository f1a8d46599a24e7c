"""Motion capture exports: rigid bodies and markers in three dimensions."""
