"""Which files and folders among many are logs: by name, else by how they begin."""

from __future__ import annotations

import re
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.pictures.picture_folder import is_picture_folder
from tunenet_logs.formats.registry import is_known
from tunenet_logs.formats.ros2_folder import is_bag_folder
from tunenet_logs.regular_file import open_regular

_MESSAGES = (".mcap", ".bag", ".db3", ".mcap.zstd", ".db3.zstd", ".mcap.zst", ".bag.gz", ".mcap.gz")
_FILMS = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mts", ".m2ts", ".wmv", ".mjpeg")
_EXPORTS = (".c3d", ".trc", ".csv", ".tsv", ".trk")
_LOGS = (*_MESSAGES, *_FILMS, *_EXPORTS)
"""Endings of what is a log, be it damaged."""

_PERHAPS = (".txt", ".npy", ".npz", ".mat", ".parquet", ".jsonl", ".xlsx", ".ods", ".zip", ".gz")
_PERHAPS += (".zst", ".bz2", ".xml", "")
"""Endings of what may be one."""

_OWN = ("ledger.parquet", "ledger.csv")
"""Files that tuning many logs writes."""

_NUMBER = re.compile(r"[-+]?[0-9]*[.,]?[0-9]+(?:[eE][-+]?[0-9]+)?")

_START_BYTES = 4096
"""Of a text, in which a table has rows."""


def is_log_name(name: str) -> bool:
    """Whether a file is a log by its name alone."""
    return name.lower().endswith(_LOGS) and name.lower() not in _OWN


def may_be_log(path: Path) -> bool:
    """Whether a file in a folder of many is meant as a log."""
    if is_log_name(path.name):
        return path.is_file()
    if path.suffix.lower() not in _PERHAPS or path.name in _OWN or not path.is_file():
        return False
    try:
        with open_regular(path) as file:
            start = file.read(_START_BYTES)
        if path.suffix.lower() == ".txt":
            return any(map(_is_row, start.decode(errors="replace").splitlines()))
        return bool(start) and is_known(path)
    except (LogError, OSError):
        return False


def _is_row(line: str) -> bool:
    """Whether a line of a text is two numbers or more."""
    cells = re.split(r"[,;\s]+", line.strip())
    return len(cells) > 1 and all(_NUMBER.fullmatch(cell) for cell in cells)


def is_log_folder(path: Path) -> bool:
    """Whether a folder is one log: a bag's, or one of numbered pictures."""
    try:
        return is_bag_folder(path) or is_picture_folder(path)
    except OSError:
        return False
