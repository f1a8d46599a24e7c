"""The containers and encodings that are read; a new one is one file, and one line here.

Which container a file is, its first bytes tell; names tell little.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import Container, Decode, RawChannel, UnusableError
from tunenet_logs.formats.compression import ZSTD_MAGIC
from tunenet_logs.formats.csv_table import read_csv
from tunenet_logs.formats.database import MAGIC as DB3_MAGIC
from tunenet_logs.formats.json_messages import json_decoder
from tunenet_logs.formats.mcap_container import MAGIC as MCAP_MAGIC
from tunenet_logs.formats.mcap_container import read_mcap
from tunenet_logs.formats.protobuf import protobuf_decoder
from tunenet_logs.formats.ros import ros_decoder
from tunenet_logs.formats.ros1_bag import MAGIC as BAG_MAGIC
from tunenet_logs.formats.ros1_bag import read_bag
from tunenet_logs.formats.ros2_db3 import read_db3
from tunenet_logs.formats.ros2_folder import read_folder
from tunenet_logs.formats.tables.lines import SUFFIXES, is_table
from tunenet_logs.formats.video import read_video

_CONTAINERS: dict[bytes, Container] = {
    MCAP_MAGIC: read_mcap,
    BAG_MAGIC: read_bag,
    DB3_MAGIC: read_db3,
}
"""Files of messages, by their first bytes."""

DECODERS: dict[str, Callable[[RawChannel], Decode]] = {
    "cdr": ros_decoder,
    "ros1": ros_decoder,
    "protobuf": protobuf_decoder,
    "json": json_decoder,
}
"""Encodings of messages; a function makes the decoder for a channel, or raises UnusableError."""


def open_log(path: Path) -> Container | Episode:
    """How the messages of a log are read; or the episode, where a file is no such container.

    Raises:
        LogError: there is no such file, or it is nothing that is read here.
    """
    try:
        if path.is_dir():
            return read_folder
        if not path.exists():
            raise LogError(f"{path}: no such file")
        if not path.is_file():
            raise LogError(f"{path}: is no regular file; record it to one first")
        with open(path, "rb") as file:
            start = file.read(max(map(len, _CONTAINERS)))
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    if not start:
        raise LogError(f"{path}: is empty; record it again")
    if start.startswith(ZSTD_MAGIC):
        raise LogError(f"{path}: is compressed as a whole; unpack it first with `zstd -d`")
    for magic, container in _CONTAINERS.items():
        if start.startswith(magic):
            return container
    return _read_foreign(path)


def is_folder(path: Path) -> bool:
    """Whether a log is a folder of files; not where that cannot even be asked."""
    try:
        return path.is_dir()
    except OSError:
        return False


def file_bytes(path: Path) -> int:
    """Size of a log [bytes], of all files of a folder's."""
    files = path.iterdir() if path.is_dir() else (path,)
    return sum(file.stat().st_size for file in files if file.is_file())


def decoder_for(channel: RawChannel) -> Decode:
    """How the channel's messages are decoded.

    Raises:
        UnusableError: they cannot be.
    """
    if channel.encoding not in DECODERS:
        known = ", ".join(DECODERS)
        raise UnusableError(
            f"message encoding {channel.encoding[:20]!r} is not read (only {known})"
        )
    return DECODERS[channel.encoding](channel)


def _read_foreign(path: Path) -> Episode:
    """A file of no messages: a table, a video, or nothing that is read here."""
    try:
        if is_table(path):
            return read_csv(path)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    try:
        return read_video(path)
    except LogError as error:
        why = str(error).removeprefix(f"{path}: ")
        known = f"an MCAP log, a bag (.bag, .db3), a table ({', '.join(SUFFIXES)}) or a video"
        remedy = "convert it to one of these or, if it is one, record or copy it again"
        raise LogError(f"{path}: is not {known}: it {why}; {remedy}") from error
