"""Spreadsheets, and exports of sensors and phones."""
