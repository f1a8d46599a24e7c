"""Bounces as a microphone hears them, made by code, and what is told of them."""
