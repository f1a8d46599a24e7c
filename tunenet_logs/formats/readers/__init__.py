"""Exports of programs and laboratory instruments: one file per kind."""
