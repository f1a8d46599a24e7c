"""GStreamer's RTSP server as a camera of a test; the test is skipped where it is not installed."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest

from tests.recorders.live_wait import ending

_SERVER = Path(__file__).with_name("gst_rtsp_server.py")
_PYTHON = "/usr/bin/python3"
_WHAT_IT_NEEDS = """
import gi
gi.require_version("GstRtspServer", "1.0")
from gi.repository import Gst
Gst.init(None)
assert Gst.ElementFactory.find("x264enc")
"""

# A live source of H.264 without an end, 30 Hz.
TEST_PICTURES = (
    "( videotestsrc is-live=true ! video/x-raw,width=320,height=240,framerate=30/1 "
    "! x264enc tune=zerolatency key-int-max=10 ! rtph264pay name=pay0 pt=96 )"
)


def file_pictures(path: Path, codec: str = "h264") -> str:
    """The pictures of an MP4 in H.264 or H.265, as they are compressed, at their times."""
    return f"( filesrc location={path} ! qtdemux ! {codec}parse ! rtp{codec}pay name=pay0 pt=96 )"


@cache
def _is_installed() -> bool:
    if not Path(_PYTHON).exists():
        return False
    words = [_PYTHON, "-c", _WHAT_IT_NEEDS]
    return not subprocess.run(words, capture_output=True, check=False).returncode


@contextmanager
def gst_rtsp_server(pictures: str = TEST_PICTURES, **options: object) -> Iterator[str]:
    """Serves pictures; its address without a scheme.

    Args:
        pictures: a pipeline whose payloader is called pay0.
        options: as the server's own: transports ("udp", "tcp" or both with a comma), auth ("basic"
            or "digest", of me and secret), tls (a PEM file with certificate and key).
    """
    if not _is_installed():
        pytest.skip("GStreamer's RTSP server, x264enc or python3-gi is not installed")
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    process = subprocess.Popen(
        [_PYTHON, str(_SERVER), pictures, *words], stdout=subprocess.PIPE, text=True
    )
    with ending(process):
        assert process.stdout is not None
        yield f"127.0.0.1:{int(process.stdout.readline())}/stream"
