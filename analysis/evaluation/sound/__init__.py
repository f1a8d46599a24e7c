"""Synthesise bounces as a microphone hears them, and tune from them."""
