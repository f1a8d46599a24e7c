"""System identification: any simulator's parameters from any log that shows what it simulates."""
