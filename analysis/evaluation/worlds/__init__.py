"""Made-up worlds whose truth is known; they share no code with what is fitted to them."""
