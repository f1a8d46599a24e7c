"""What a log is: episodes, and the crash-safe, schema'd MCAP files that hold them."""

__version__ = "0.1.0"
