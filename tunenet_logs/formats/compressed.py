"""Decompress parts of a log and whole files, bounded against decompression bombs.

A chunk or message unpacks to exactly the size that its container states. A file that was compressed
as a whole states none: it is unpacked to a temporary file, within the `Budget` of its own size.
"""

from __future__ import annotations

import bz2
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

from tunenet_logs.errors import LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.base import Budget, Loss, OverBudgetError, described

MAX_PART_BYTES = 128 * 1024 * 1024  # that one chunk or message may unpack to
MAX_FOREIGN_BYTES = 1024**3  # unpacked of a file of no messages; no larger one is read
_MAX_WINDOW_BYTES = 128 * 1024 * 1024  # what zstd may look back; its own default
# Begins a file, or a message that a recorder compressed by itself, as ROS 2 can. No other message
# of ROS begins like this: its encoding begins with a zero.
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
# What the libraries raise on damaged data; an OSError is bz2's.
_ERRORS = (
    *(zstandard.ZstdError, zlib.error, RuntimeError, OSError),
    *(ValueError, EOFError, MemoryError),
)


@dataclass(frozen=True)
class Compression:
    """A way to compress; a new one is a row of `COMPRESSIONS`."""

    magic: bytes  # first bytes of a file
    suffixes: tuple[str, ...]  # of a file, behind that of the file inside
    command: str  # that unpacks a file
    begin: Callable[[], Any]  # makes a decompressor of a stream
    bounds_output: bool = True  # whether that takes `max_length`, a bound of what it returns


def _zstd() -> Any:
    return zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES).decompressobj()


# By name, as in containers; those of ROS 1 say "bz2".
COMPRESSIONS = {
    "zstd": Compression(ZSTD_MAGIC, (".zstd", ".zst"), "zstd -d", _zstd, bounds_output=False),
    "gzip": Compression(b"\x1f\x8b\x08", (".gz",), "gunzip", lambda: zlib.decompressobj(31)),
    "bzip2": Compression(b"BZh", (".bz2",), "bunzip2", bz2.BZ2Decompressor),
    "lz4": Compression(b"\x04\x22\x4d\x18", (".lz4",), "lz4 -d", lz4.frame.LZ4FrameDecompressor),
}
_IN_CONTAINERS = {"bz2": "bzip2", "lz4": "lz4"}  # parts that are fed as streams; zstd has its own


def unpack_message(message: bytes | memoryview, budget: Budget) -> bytes | memoryview:
    """Decompress a message that begins with `ZSTD_MAGIC`; raises as `unpack`."""
    try:
        stated = zstandard.get_frame_parameters(message).content_size
    except zstandard.ZstdError as error:
        raise ValueError(f"zstd data is damaged: {error}") from error
    if stated <= MAX_PART_BYTES:
        budget.spend(stated)
    return unpack(message, "zstd", stated)


def unpack(data: bytes | memoryview, compression: str, stated: int) -> bytes | memoryview:
    """Decompress a part ("zstd", "lz4", "bz2", "") of exactly the stated size, else ValueError."""
    if stated > MAX_PART_BYTES:
        raise ValueError(f"a part claims {stated} bytes, over the limit of {MAX_PART_BYTES}")
    try:
        if compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(data) as stream:
                plain = stream.read(stated + 1)
        elif compression in _IN_CONTAINERS:
            stream = COMPRESSIONS[_IN_CONTAINERS[compression]].begin()
            plain = stream.decompress(data, max_length=stated + 1)
        elif compression in ("", "none"):
            plain = data
        else:
            raise ValueError(f"unknown compression {compression[:20]!r}")
    except (zstandard.ZstdError, RuntimeError, OSError, EOFError, MemoryError) as error:
        raise ValueError(f"{compression} data is damaged: {error}") from error
    if len(plain) != stated:
        raise ValueError(f"a part holds {len(plain)} bytes where it states {stated}")
    return plain


def unpack_start(data: bytes | memoryview, compression: str, most: int) -> bytes:
    """Decompress at most `most` bytes of truncated data; nothing of an unknown compression."""
    if compression in ("", "none"):
        return bytes(data[:most])
    plain = bytearray()
    size = 64 * 1024  # fed or unpacked at a time, to keep what is whole
    with suppress(*_ERRORS):  # what came before is whole
        if compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(data) as packed:
                while piece := packed.read(min(size, most - len(plain))):
                    plain += piece
        elif compression in _IN_CONTAINERS:
            stream = COMPRESSIONS[_IN_CONTAINERS[compression]].begin()
            for at in range(0, len(data), size):
                plain += stream.decompress(data[at : at + size], max_length=most - len(plain))
                if stream.eof or len(plain) >= most:
                    break
    return bytes(plain)


# ---- Whole files: unpack one to a temporary file.


class _CutError(Exception):
    """Decompression ended before the end."""


def compression_of(start: bytes) -> str:
    """Detect a whole-file compression by the first bytes: "zstd", "gzip", ..., or ""."""
    return next((name for name, one in COMPRESSIONS.items() if start.startswith(one.magic)), "")


def unpacked_start(path: Path, compression: str, most: int) -> bytes:
    """Decompress the beginning of the file inside, `most` bytes at most."""
    plain = bytearray()
    with suppress(_CutError):  # what came before is whole
        for piece in _pieces(path, compression):
            plain += piece
            if len(plain) >= most:
                break
    return bytes(plain[:most])


@contextmanager
def unpacked(
    path: Path, compression: str, losses: list[Loss], budget: Budget, most_bytes: int | None = None
) -> Iterator[Path]:
    """Decompress the file inside, as far as possible, and yield its temporary path.

    Neither the file nor its folder is changed. `most_bytes` limits the size inside, whatever the
    compressed one is; damage is added to `losses`.

    Raises:
        LogError: nothing can be decompressed, it is more than a log may hold, or there is no room.
        OSError: the disk fails.
    """
    suffixes = [suffix for one in COMPRESSIONS.values() for suffix in one.suffixes]
    name = path.stem if path.suffix.lower() in suffixes and path.stem else path.name
    with tempfile.TemporaryDirectory(prefix="tunenet-logs-") as folder:
        plain = Path(folder) / name  # "drop.mcap.zst" holds drop.mcap
        room = int(0.9 * shutil.disk_usage(folder).free)  # of the system's temporary folder
        written = 0
        try:
            with open(plain, "wb") as file:
                for piece in _pieces(path, compression):
                    budget.spend(len(piece))
                    written += len(piece)
                    if most_bytes is not None and written > most_bytes:
                        raise LogError(
                            f"{path}: unpacks to over {most_bytes >> 20} MiB, the limit; split it"
                        )
                    if written > room:
                        raise LogError(
                            f"{path}: unpacks to more than there is room in "
                            f"{plain.parent.parent}; make room, or set TMPDIR to a folder that has "
                            "it"
                        )
                    file.write(piece)
        except OverBudgetError as error:
            raise LogError(
                f"{path}: {error}, which no recording does; if you trust it, unpack it first"
            ) from error
        except _CutError as cut:
            what = f"its {compression} data is {cut}; what precedes that was read"
            losses.append(Loss(what, size=written))
        if not written:
            raise LogError(
                f"{path}: nothing of its {compression} data can be unpacked; copy it again"
            )
        yield plain


def _pieces(path: Path, compression: str) -> Iterator[bytes]:
    """Yield the decompressed data piece by piece, all before the damage of a `_CutError`."""
    kind = COMPRESSIONS[compression]
    stream, waiting = kind.begin(), b""
    with open_regular(path) as file:
        # Little at a time: zstd bounds no output, which is 64 MiB at most then.
        while data := waiting or file.read(2048):
            if stream.eof:  # several may lie one behind the other
                if not any(data):
                    waiting = b""
                    continue  # padding
                stream = kind.begin()
            is_fed = False
            while not is_fed:
                try:
                    if not kind.bounds_output:
                        piece, is_fed = stream.decompress(data), True
                    else:
                        piece = stream.decompress(data, 1024 * 1024)
                        data = getattr(stream, "unconsumed_tail", b"")  # gzip's; others keep it
                        needs_input = getattr(stream, "needs_input", not data)
                        is_fed = stream.eof or needs_input
                except _ERRORS as error:
                    raise _CutError(f"damaged ({described(error)})") from error
                yield piece
            waiting = stream.unused_data if stream.eof else b""
    if not stream.eof:
        raise _CutError("cut, as of a copy that was broken off")
