"""Common parts of all reviews in Rerun: charts, colours, texts, writing."""
