"""Streams that claim much and hold little: refused, with little memory."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.mp4_bombs import FILE_TYPE, mp4_of_many
from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import ROOT

pytestmark = pytest.mark.live

_MAX_BYTES = 1_500_000_000  # of address space; FFmpeg with its threads needs a third


MATROSKA = bytes.fromhex("1a45dfa39f4286810142f7810142f2810442f381084282886d6174726f736b61")
MATROSKA += bytes.fromhex("42878104428581021853806701ffffffffffffff1654ae6b080fffffff")


@pytest.mark.parametrize(
    ("start", "again", "says"),
    [
        (mp4_of_many(80_000_000), b"", "claims 80000000 samples in"),
        (FILE_TYPE + b"\xff\xff\xff\xffmoov", b"\0", "holds no video"),
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
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({_MAX_BYTES},) * 2)\n"
        "from tunenet_logs.recorders.camera.sources import open_source\n"
        "print(list(open_source('-').frames()))"
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
