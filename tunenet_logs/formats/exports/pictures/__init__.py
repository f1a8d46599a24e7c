"""Image sequences in folders and archives, and animated images."""
