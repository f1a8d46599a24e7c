"""One file per container or message encoding that logs come in."""
