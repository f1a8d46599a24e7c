"""Recognize logs among many files and folders: by name, else by their first bytes."""

from __future__ import annotations

from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.pictures.picture_folder import is_picture_folder
from tunenet_logs.formats.registry import is_known
from tunenet_logs.formats.ros2_folder import is_bag_folder
from tunenet_logs.regular_file import open_regular

_MESSAGES = (".mcap", ".bag", ".db3", ".mcap.zstd", ".db3.zstd", ".mcap.zst", ".bag.gz", ".mcap.gz")
_FILMS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts", ".m2ts", ".wmv", ".mjpeg")
_EXPORTS = (".c3d", ".trc", ".csv", ".tsv", ".trk", ".sto", ".mot")
_LOGS = (*_MESSAGES, *_FILMS, *_EXPORTS)  # endings of what is a log, be it damaged
_PERHAPS = (
    ".txt",
    ".dat",
    ".log",
    ".npy",
    ".npz",
    ".mat",
    ".parquet",
    ".jsonl",
    ".xlsx",
    ".ods",
    ".zip",
    ".gz",
)
_PERHAPS += (".zst", ".bz2", ".xml", "")
"""Endings of what may be one."""

_OWN = ("ledger.parquet", "ledger.csv")  # files that tuning many logs writes


def is_log_name(name: str) -> bool:
    """Return whether a file is a log by its name alone."""
    return name.lower().endswith(_LOGS) and name.lower() not in _OWN


def may_be_log(path: Path) -> bool:
    """Return whether a file in a folder of many is meant as a log."""
    if is_log_name(path.name):
        return path.is_file()
    if path.suffix.lower() not in _PERHAPS or path.name in _OWN or not path.is_file():
        return False
    try:
        with open_regular(path) as file:
            is_empty = not file.read(1)
        return not is_empty and is_known(path)
    except (LogError, OSError):
        return False


def is_log_folder(path: Path) -> bool:
    """Return whether a folder is one log: a bag, or an image sequence."""
    try:
        return is_bag_folder(path) or is_picture_folder(path)
    except OSError:
        return False
