"""Streams that claim much and hold little: refused, with little memory."""

from __future__ import annotations

import os
import struct
import subprocess
import sys

import pytest

from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import ROOT

pytestmark = pytest.mark.live

_MOST_BYTES = 1_500_000_000
"""Of address space; FFmpeg with its threads needs a third."""


def box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def mp4_of_many(count: int) -> bytes:
    """An MP4 that says in 575 bytes that so many pictures follow."""
    header = struct.pack(">IIIII", 0, 0, 0, 1000, 1000) + bytes(80)
    entry = box(b"jpeg", bytes(6), b"\0\1", bytes(16), struct.pack(">HH", 64, 48), bytes(50))
    table = box(
        b"stbl",
        box(b"stsd", struct.pack(">II", 0, 1), entry),
        box(b"stts", struct.pack(">IIII", 0, 1, count, 1)),
        box(b"stsc", struct.pack(">IIIII", 0, 1, 1, count, 1)),
        box(b"stsz", struct.pack(">III", 0, 100, count)),
        box(b"stco", struct.pack(">III", 0, 1, 1000)),
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
    return box(b"ftyp", b"isom\0\0\0\0") + box(b"moov", box(b"mvhd", header), track)


MATROSKA = bytes.fromhex("1a45dfa39f4286810142f7810142f2810442f381084282886d6174726f736b61")
MATROSKA += bytes.fromhex("42878104428581021853806701ffffffffffffff1654ae6b080fffffff")


@pytest.mark.parametrize(
    ("start", "again", "says"),
    [
        (mp4_of_many(80_000_000), b"", "claims 80000000 samples in"),
        (box(b"ftyp", b"isom\0\0\0\0") + b"\xff\xff\xff\xffmoov", b"\0", "holds no video"),
        (MATROSKA, b"a", "sends 64 MiB without a picture"),
        pytest.param(
            b"FLV\1\1\0\0\0\x09\0\0\0\0",
            b"\x09\xff\xff\xff" + bytes(7),
            "sends 64 MiB without",
            marks=pytest.mark.slow,
        ),
        (b"", b"G" + bytes(187), "sends 64 MiB without a picture"),
        (b"\0\0\0\1\x67\x42", b"\x11", "sends 64 MiB without a picture"),
        pytest.param(
            b"\xff\xd8\xff\xe0",
            b"\x11",
            "sends 64 MiB without a picture",
            marks=pytest.mark.slow,
        ),
        (b"--x\r\nContent-Type: image/jpeg\r\n\r\n", b"\xff", "sends a part of more than"),
    ],
)
def test_nothing_is_kept_without_a_bound(start: bytes, again: bytes, says: str):
    words = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({_MOST_BYTES},) * 2)\n"
        "from recorders.camera.sources import open_source; print(list(open_source('-').frames()))"
    )
    ours, theirs = os.pipe()
    recorder = subprocess.Popen(
        [sys.executable, "-c", words], cwd=ROOT, stdin=ours, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    os.close(ours)
    with os.fdopen(theirs, "wb", buffering=0) as camera:
        try:
            camera.write(start)
            for _ in range(200 if again else 0):
                camera.write(again * (1_000_000 // len(again)))
        except BrokenPipeError:
            pass
    out, _ = recorder.communicate(timeout=LAST_RESORT_S)
    assert says in out.splitlines()[-1]
    assert "PyAV library exception" not in out
