"""Exports of programs that track things in videos."""
