"""Tests of the room that tunes any simulator."""
