"""The parts of reading a table: lines, times, what column names mean, and how they belong."""
