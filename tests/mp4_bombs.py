"""MP4 files of some hundred bytes that claim pictures without end."""

from __future__ import annotations

import struct

FILE_TYPE = struct.pack(">I4s4sI", 16, b"ftyp", b"isom", 0)  # the box with which a file begins


def box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def mp4_of_many(count: int) -> bytes:
    """A film that says in 535 bytes that so many pictures follow."""
    return FILE_TYPE + box(b"moov", *_of_film(count))


def fragment_of_many(count: int) -> bytes:
    """The same of a fragment behind a film without pictures."""
    extends = box(b"mvex", box(b"trex", struct.pack(">IIIIII", 0, 1, 1, 1, 0, 0)))
    run = box(b"trun", struct.pack(">II", 0, count))
    track = box(b"traf", box(b"tfhd", struct.pack(">II", 0, 1)), run)
    fragment = box(b"moof", box(b"mfhd", struct.pack(">II", 0, 1)), track)
    return FILE_TYPE + box(b"moov", *_of_film(0), extends) + fragment + box(b"mdat", bytes(1000))


def _of_film(count: int) -> tuple[bytes, bytes]:
    header = struct.pack(">IIIII", 0, 0, 0, 1000, 1000) + bytes(80)
    entry = box(b"jpeg", bytes(6), b"\0\1", bytes(16), struct.pack(">HH", 64, 48), bytes(50))
    entries = min(count, 1)
    table = box(
        b"stbl",
        box(b"stsd", struct.pack(">II", 0, 1), entry),
        box(b"stts", struct.pack(">II", 0, entries), struct.pack(">II", count, 1) * entries),
        box(b"stsc", struct.pack(">II", 0, entries), struct.pack(">III", 1, count, 1) * entries),
        box(b"stsz", struct.pack(">III", 0, 100 * entries, count)),
        box(b"stco", struct.pack(">II", 0, entries), struct.pack(">I", 1000) * entries),
    )
    media = box(
        b"mdia",
        box(b"mdhd", struct.pack(">IIIIIHH", 0, 0, 0, 90000, 1000, 0, 0)),
        box(b"hdlr", struct.pack(">II4s", 0, 0, b"vide"), bytes(13)),
        box(b"minf", box(b"vmhd", bytes(12)), table),
    )
    track = box(
        b"trak", box(b"tkhd", struct.pack(">IIIIII", 7, 0, 0, 1, 0, 1000), bytes(60)), media
    )
    return box(b"mvhd", header), track
