"""Table reading: lines, times, meaning of column names, and layout."""
