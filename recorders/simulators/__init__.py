"""Episode sources that can be asked again with other parameters."""
