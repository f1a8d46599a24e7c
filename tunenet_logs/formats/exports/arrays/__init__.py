"""Files of arrays, columns and records, interpreted by the names of their content."""
