"""Decompress files that were compressed as a whole, bounded, to a temporary file."""

from __future__ import annotations

import bz2
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import Loss, described
from tunenet_logs.formats.budget import Budget, OverBudgetError
from tunenet_logs.formats.compression import ZSTD_MAGIC
from tunenet_logs.regular_file import open_regular

# Fed at a time: of zstd without a bound on what comes of it, which is 64 MiB at most then.
_READ_BYTES = 2048

_PIECE_BYTES = 1024 * 1024  # unpacked at a time, where that can be bounded
_MAX_WINDOW_BYTES = 128 * 1024 * 1024  # what zstd may look back; its own default
MAX_FOREIGN_BYTES = 1024**3  # unpacked of a file of no messages; none is read that is larger
_FREE_SHARE = 0.9  # of the room of the system's folder for such files
# Kinds of compression, by the first bytes of a file.
_UNPACKERS = {
    ZSTD_MAGIC: "zstd",
    b"\x1f\x8b\x08": "gzip",
    b"BZh": "bzip2",
    b"\x04\x22\x4d\x18": "lz4",
}

# Of such files, behind what they are when unpacked.
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
