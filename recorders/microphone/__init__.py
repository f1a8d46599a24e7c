"""Record a microphone beside a live camera, on the clock of the pictures."""
