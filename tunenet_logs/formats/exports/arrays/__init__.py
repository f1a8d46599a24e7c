"""Files of arrays, columns and records, by the names of what they hold."""
