"""PyBullet as one of the engines: all that imports it, or speaks its keywords, is here."""
