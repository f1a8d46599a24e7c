"""Measure the tuning of filmed drops' tracks: rigs drawn at random, good and faulty tracks."""
