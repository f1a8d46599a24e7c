"""Exports of programs that track objects in videos."""
