"""Folders and archives of pictures, and animated ones."""
