"""The bounce shot: a ball released above an inclined plane is to fall through a hoop."""
