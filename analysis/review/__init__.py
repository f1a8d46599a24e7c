"""What all reviews share: charts, colours, words, and how they get into a recording."""
