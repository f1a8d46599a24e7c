"""A ball that is let go above an inclined plane and is to fall through a hoop."""
