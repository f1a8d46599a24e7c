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
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

from tunenet_logs.errors import LogError
from tunenet_logs.files import open_regular
from tunenet_logs.formats.base import Budget, Loss, OverBudgetError, described

MAX_PART_BYTES = 128 * 1024 * 1024  # that one chunk or message may unpack to
_CUT_PIECE_BYTES = 64 * 1024  # unpacked at a time of cut data: what precedes the damage is kept
# Begins a file, or a message that a recorder compressed by itself, as ROS 2 can. No other message
# of ROS begins like this: its encoding begins with a zero.
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def unpack_message(message: bytes | memoryview, budget: Budget) -> bytes | memoryview:
    """Decompress a message that begins with `ZSTD_MAGIC`.

    Raises:
        ValueError: it is damaged or too large.
        OverBudgetError: the log decompresses to more than the limit.
    """
    try:
        stated = zstandard.get_frame_parameters(message).content_size
    except zstandard.ZstdError as error:
        raise ValueError(f"zstd data is damaged: {error}") from error
    if stated <= MAX_PART_BYTES:
        budget.spend(stated)
    return unpack(message, "zstd", stated)


def unpack(data: bytes | memoryview, compression: str, stated: int) -> bytes | memoryview:
    """Decompress a part of exactly the stated size.

    Args:
        data: compressed bytes.
        compression: "zstd", "lz4", "bz2", or "" or "none".
        stated: the size that the file claims; it is verified.

    Raises:
        ValueError: damaged, of another size than stated, too large, or of an unknown compression.
    """
    if stated > MAX_PART_BYTES:
        raise ValueError(f"a part claims {stated} bytes, over the limit of {MAX_PART_BYTES}")
    try:
        if compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(data) as stream:
                plain = stream.read(stated + 1)
        elif compression == "lz4":
            plain = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=stated + 1)
        elif compression == "bz2":
            plain = bz2.BZ2Decompressor().decompress(data, max_length=stated + 1)
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
    """Decompress as much as possible of truncated data; nothing of an unknown compression.

    Args:
        data: compressed bytes, with or without their end.
        compression: "zstd", "lz4", "bz2", or "" or "none".
        most: bytes to decompress at most.
    """
    if compression in ("", "none"):
        return bytes(data[:most])
    plain = bytearray()
    if compression == "zstd":
        unpacker = zstandard.ZstdDecompressor()
        with suppress(zstandard.ZstdError), unpacker.stream_reader(data) as packed:
            while (room := most - len(plain)) > 0 and (
                piece := packed.read(min(_CUT_PIECE_BYTES, room))
            ):
                plain += piece
        return bytes(plain)
    if compression not in ("lz4", "bz2"):
        return b""
    stream = lz4.frame.LZ4FrameDecompressor() if compression == "lz4" else bz2.BZ2Decompressor()
    try:
        for at in range(0, len(data), _CUT_PIECE_BYTES):
            piece = data[at : at + _CUT_PIECE_BYTES]
            plain += stream.decompress(piece, max_length=most - len(plain))
            if stream.eof or len(plain) >= most:
                break
    except (RuntimeError, OSError, EOFError, MemoryError):
        pass  # what came before is whole
    return bytes(plain)


# ---- Whole files: unpack one to a temporary file.

_READ_BYTES = 2048  # fed at a time: zstd bounds no output, which is 64 MiB at most then
_PIECE_BYTES = 1024 * 1024  # unpacked at a time, where that can be bounded
_MAX_WINDOW_BYTES = 128 * 1024 * 1024  # what zstd may look back; its own default
MAX_FOREIGN_BYTES = 1024**3  # unpacked of a file of no messages; no larger one is read
_FREE_SHARE = 0.9  # of the free room of the system's temporary folder
# Kinds of compression, by the first bytes of a file.
_UNPACKERS = {
    ZSTD_MAGIC: "zstd",
    b"\x1f\x8b\x08": "gzip",
    b"BZh": "bzip2",
    b"\x04\x22\x4d\x18": "lz4",
}

# Behind the suffix of the file inside.
SUFFIXES = (".zstd", ".zst", ".gz", ".bz2", ".lz4")

# What the libraries raise on damaged data.
_ERRORS = (
    zstandard.ZstdError,
    zlib.error,
    RuntimeError,
    OSError,
    ValueError,
    EOFError,
    MemoryError,
)


class _CutError(Exception):
    """Decompression ended before the end."""


def compression_of(start: bytes) -> str:
    """Detect a whole-file compression by the first bytes: "zstd", "gzip", ..., or ""."""
    return next((kind for magic, kind in _UNPACKERS.items() if start.startswith(magic)), "")


def unpacked_name(path: Path) -> str:
    """Return the name of the file inside: "drop.mcap.zst" holds drop.mcap."""
    return path.stem if path.suffix.lower() in SUFFIXES and path.stem else path.name


def unpacked_start(path: Path, compression: str, most: int) -> bytes:
    """Decompress the beginning of the file inside, `most` bytes at most.

    Raises:
        OSError: the file cannot be read.
    """
    plain = bytearray()
    try:
        for piece in _pieces(path, compression):
            plain += piece
            if len(plain) >= most:
                break
    except _CutError:
        pass  # what came before is whole
    return bytes(plain[:most])


@contextmanager
def unpacked(
    path: Path,
    compression: str,
    losses: list[Loss],
    budget: Budget,
    most_bytes: int | None = None,
) -> Iterator[Path]:
    """Decompress the file inside, as far as possible, and yield its temporary path.

    Args:
        path: the compressed file; neither it nor its folder is changed.
        compression: as `compression_of` returns it.
        losses: damage found.
        budget: remaining decompression budget.
        most_bytes: limit of the decompressed size, regardless of the compressed one.

    Raises:
        LogError: nothing can be decompressed, it is more than a log may hold, or there is no room.
        OSError: the disk fails.
    """
    with tempfile.TemporaryDirectory(prefix="tunenet-logs-") as folder:
        plain = Path(folder) / unpacked_name(path)
        written = _unpack(path, compression, plain, budget, losses, most_bytes)
        if not written:
            raise LogError(
                f"{path}: nothing of its {compression} data can be unpacked; copy it again"
            )
        yield plain


def _unpack(
    path: Path,
    compression: str,
    plain: Path,
    budget: Budget,
    losses: list[Loss],
    most_bytes: int | None,
) -> int:
    """Decompress to `plain` and return the bytes written; raises as `unpacked` does."""
    room = int(_FREE_SHARE * shutil.disk_usage(plain.parent).free)
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
                        f"{path}: unpacks to more than there is room in {plain.parent.parent}; "
                        "make room, or set TMPDIR to a folder that has it"
                    )
                file.write(piece)
    except OverBudgetError as error:
        raise LogError(
            f"{path}: {error}, which no recording does; if you trust it, unpack it first"
        ) from error
    except _CutError as cut:
        what = f"its {compression} data is {cut}; what precedes that was read"
        losses.append(Loss(what, size=written))
    return written


def _pieces(path: Path, compression: str) -> Iterator[bytes]:
    """Yield the decompressed data piece by piece.

    Raises:
        _CutError: the data is damaged or ends too early; all that precedes it was yielded.
        OSError: the disk fails.
    """
    begin, feed = _KINDS[compression]
    stream, waiting = begin(), b""
    with open_regular(path) as file:
        while data := waiting or file.read(_READ_BYTES):
            if stream.eof:  # several may lie one behind the other
                if not any(data):
                    waiting = b""
                    continue  # padding
                stream = begin()
            pieces = feed(stream, data)
            while True:
                try:
                    piece = next(pieces, None)
                except _ERRORS as error:
                    raise _CutError(f"damaged ({described(error)})") from error
                if piece is None:
                    break
                yield piece
            waiting = stream.unused_data if stream.eof else b""
    if not stream.eof:
        raise _CutError("cut, as of a copy that was broken off")


def _feed_zstd(stream: Any, data: bytes) -> Iterator[bytes]:
    yield stream.decompress(data)


def _feed_gzip(stream: Any, data: bytes) -> Iterator[bytes]:
    while data and not stream.eof:
        yield stream.decompress(data, _PIECE_BYTES)
        data = stream.unconsumed_tail


def _feed_others(stream: Any, data: bytes) -> Iterator[bytes]:
    yield stream.decompress(data, _PIECE_BYTES)
    while not (stream.eof or stream.needs_input):
        yield stream.decompress(b"", _PIECE_BYTES)


def _zstd() -> Any:
    return zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES).decompressobj()


# What begins a stream of each kind, and what feeds it.
_KINDS: dict[str, tuple[Callable[[], Any], Callable[[Any, bytes], Iterator[bytes]]]] = {
    "zstd": (_zstd, _feed_zstd),
    "gzip": (lambda: zlib.decompressobj(31), _feed_gzip),
    "bzip2": (bz2.BZ2Decompressor, _feed_others),
    "lz4": (lz4.frame.LZ4FrameDecompressor, _feed_others),
}
