"""Bounded decompression: never more bytes than the file states."""

from __future__ import annotations

import bz2
from contextlib import suppress

import lz4.frame
import zstandard

from tunenet_logs.formats.budget import Budget

# The most that one part of a log (a chunk, a message) may unpack to.
MAX_PART_BYTES = 128 * 1024 * 1024

# Unpacked at a time of data that is cut, so that what precedes the damage is kept.
_PIECE_BYTES = 64 * 1024

# The first bytes of a file, or of a message that a recorder packed by itself, as ROS 2 can. No
# message of ROS begins like this otherwise: its encoding begins with a zero.
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
                piece := packed.read(min(_PIECE_BYTES, room))
            ):
                plain += piece
        return bytes(plain)
    if compression not in ("lz4", "bz2"):
        return b""
    stream = lz4.frame.LZ4FrameDecompressor() if compression == "lz4" else bz2.BZ2Decompressor()
    try:
        for at in range(0, len(data), _PIECE_BYTES):
            piece = data[at : at + _PIECE_BYTES]
            plain += stream.decompress(piece, max_length=most - len(plain))
            if stream.eof or len(plain) >= most:
                break
    except (RuntimeError, OSError, EOFError, MemoryError):
        pass  # what came before is whole
    return bytes(plain)
