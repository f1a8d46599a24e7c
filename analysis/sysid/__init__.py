"""System identification: any simulator's parameters from any log of what it simulates."""
