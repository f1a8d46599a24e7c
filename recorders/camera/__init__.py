"""Cameras and videos as sources of frames: devices, network streams, files."""
