"""Read tracks of ImageJ plug-ins (MTrack2, Manual Tracking, MTrackJ, TrackMate) and results."""

from __future__ import annotations

from pathlib import Path

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.start import Start, start_of
from tunenet_logs.formats.exports.trackers.mtrack2 import is_mtrack2, read_mtrack2
from tunenet_logs.formats.exports.trackers.spot_rows import MAX_BYTES
from tunenet_logs.formats.exports.trackers.spot_table import read_spots, spot_layout
from tunenet_logs.formats.exports.trackers.trackmate_xml import is_trackmate_xml, read_trackmate_xml
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.lines import lines_of


def is_imagej(start: Start) -> bool:
    """Return whether a file is an ImageJ table or TrackMate XML."""
    if is_trackmate_xml(start.data):
        return True
    return bool(start.lines) and (
        is_mtrack2(start.lines[0]) or spot_layout(start.lines[0]) is not None
    )


def read_imagej(path: Path, options: ReadOptions) -> Episode:
    """Read each track as a signal: usually in pixels, y down, by frames.

    Raises:
        LogError: it holds no track, or is damaged.
        OSError: it cannot be read.
    """
    if path.stat().st_size > MAX_BYTES:
        raise LogError(f"{path}: is an ImageJ table of over {MAX_BYTES >> 20} MiB; split it")
    start = start_of(path)
    if is_trackmate_xml(start.data):
        return read_trackmate_xml(path, options)
    first = next(iter(start.lines), "")
    read = read_mtrack2 if is_mtrack2(first) else read_spots
    return read(path, lines_of(path), options)
