"""PyBullet as a physics engine: all that imports it, or names its keywords, is here."""
