"""A campaign: drops, what was tuned from them, and what the hardware then did."""
