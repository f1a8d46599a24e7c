"""How well tracks of filmed drops are tuned: rigs drawn at random, good tracks and faulty ones."""
