"""Episodes, and the crash-safe MCAP files with schemas that hold them."""

__version__ = "0.1.0"
