"""Frame sources: camera devices, network streams and video files."""
