"""MCAP as a stream of records: bounded, checked, and read as far as it is whole."""

from __future__ import annotations

import dataclasses
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.records import Chunk, DataEnd, Footer, McapRecord
from mcap.stream_reader import StreamReader, breakup_chunk

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 256 * 1024 * 1024

# What the libraries raise on damaged bytes, found by fuzzing them.
DAMAGE = (
    McapError,
    struct.error,
    ValueError,  # CRCValidationError and UnicodeDecodeError too
    RuntimeError,  # lz4; RecursionError too
    zstandard.ZstdError,
    OverflowError,
    KeyError,
    MemoryError,
)


def read_records(path: Path, losses: list[str]) -> Iterator[McapRecord]:
    """Yield the records of `path` in file order, those inside chunks one by one.

    Every CRC that the file carries is checked. A damaged chunk is left out, the first damage
    outside a chunk ends the stream; both are put into `losses` in words.

    Raises:
        LogError: `path` is no MCAP file.
    """
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        ended = False
        protected = False
        reader = StreamReader(
            file, emit_chunks=True, validate_crcs=True, record_size_limit=max(size, 1)
        )
        try:
            for record in reader.records:
                if isinstance(record, Chunk):
                    yield from _chunk_records(record, losses)
                else:
                    ended = ended or isinstance(record, Footer)
                    protected = protected or (
                        isinstance(record, DataEnd) and record.data_section_crc != 0
                    )
                    yield record
        except DAMAGE as error:
            if file.tell() >= size:
                losses.append("the end of the file is missing (a recording that did not end?)")
            else:
                losses.append(f"damaged before byte {file.tell()} of {size}: {_describe(error)}")
            return
        if not ended:
            losses.append("the end of the file is missing")
        elif not protected:
            losses.append(
                "the log carries no data checksum, so its integrity cannot be vouched for"
            )


def _chunk_records(chunk: Chunk, losses: list[str]) -> list[McapRecord]:
    try:
        data = _decompress(chunk)
        plain = dataclasses.replace(chunk, compression="", data=data, uncompressed_size=len(data))
        return breakup_chunk(plain, validate_crc=True)
    except DAMAGE as error:
        losses.append(f"a damaged chunk was left out: {_describe(error)}")
        return []


def _decompress(chunk: Chunk) -> bytes:
    """The chunk's bytes; neither its stated size nor its own header is believed."""
    limit = chunk.uncompressed_size
    if limit > MAX_CHUNK_BYTES:
        raise McapError(f"a chunk claims {limit} bytes, over the limit of {MAX_CHUNK_BYTES}")
    if chunk.compression == "":
        data = chunk.data
    elif chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
            data = stream.read(limit + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=limit + 1)
    else:
        raise McapError(f"unknown compression {chunk.compression[:20]!r}")
    if len(data) != limit:
        raise McapError(f"a chunk holds {len(data)} bytes where it states {limit}")
    return data


def _describe(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
