"""A microphone beside a live camera: its sound on the clock of the pictures."""
