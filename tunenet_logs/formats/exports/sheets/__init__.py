"""Spreadsheets and the exports of sensors and phones."""
