"""Real balls: air, a restitution that falls with speed; and whether the tuned one moves alike."""
