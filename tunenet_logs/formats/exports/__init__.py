"""Files as programs and instruments of laboratories export them: each layout is one file."""
