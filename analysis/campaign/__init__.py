"""Campaign: drops, their tunings, and the outcomes of the shots on hardware."""
