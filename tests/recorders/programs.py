"""Servers that others wrote, as cameras of a test; it is skipped where they are not installed."""

from __future__ import annotations

import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import cache
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any

import pytest

from tests.recorders.live_wait import LAST_RESORT_S, ending, free_port, wait_until

_GST_SERVER = Path(__file__).with_name("gst_rtsp_server.py")
_PYTHON = "/usr/bin/python3"  # which alone knows GStreamer
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


@contextmanager
def running(
    words: Sequence[object], answers: Callable[[], object] = lambda: True
) -> Iterator[None]:
    """A server, once it answers where that can be asked, until it is no longer needed."""
    ends: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    with ending(subprocess.Popen([*map(str, words)], text=True, **ends)):
        wait_until(answers, str(words[0]))
        yield


@contextmanager
def nginx_server(folder: Path, rules: str, certificate: Path | None = None) -> Iterator[str]:
    """Serve by nginx, as a camera's front door; its address without a scheme.

    Args:
        folder: for its files; /users of it holds who may come in: me, with secret.
        rules: what stands inside `server { }`.
        certificate: a PEM file with key and certificate, for HTTPS.
    """
    program = shutil.which("nginx")
    if program is None:
        pytest.skip("nginx is not installed")
    port = free_port()
    folder.mkdir(exist_ok=True)
    (folder / "users").write_text("me:{PLAIN}secret\n")
    (folder / "users").chmod(0o644)
    tls = f" ssl; ssl_certificate {certificate}; ssl_certificate_key {certificate};"
    (folder / "nginx.conf").write_text(
        f"daemon off; master_process off; worker_processes 1; pid {folder}/pid; "
        f"error_log {folder}/error.log; events {{ }} http {{ access_log off; "
        f"client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; "
        f"fastcgi_temp_path {folder}/f; uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s; "
        f"server {{ listen 127.0.0.1:{port}{tls if certificate else ';'} {rules} }} }}"
    )

    def listens() -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return True
        return False

    with running([program, "-p", folder, "-c", folder / "nginx.conf"], listens):
        yield f"127.0.0.1:{port}"


@contextmanager
def motion_server(folder: Path, camera: str) -> Iterator[str]:
    """Show another camera's pictures by motion to me, with secret, by digest; its address."""
    program = shutil.which("motion")
    if program is None:
        pytest.skip("motion is not installed")
    port = free_port()
    folder.mkdir()
    (folder / "motion.conf").write_text(
        f"daemon off\nsetup_mode off\nnetcam_url http://{camera}\nwidth 320\nheight 240\n"
        f"framerate 20\nstream_port {port}\nstream_localhost on\nstream_maxrate 20\n"
        "stream_auth_method 2\nstream_authentication me:secret\n"
        f"webcontrol_port 0\npicture_output off\nmovie_output off\ntarget_dir {folder}\n"
    )

    def answers() -> bool:
        asking = HTTPConnection("127.0.0.1", port, timeout=LAST_RESORT_S)
        with suppress(OSError, HTTPException), closing(asking):
            asking.request("GET", "/")
            return asking.getresponse().status in (200, 401)
        return False

    with running([program, "-c", folder / "motion.conf"], answers):
        yield f"127.0.0.1:{port}/"


def file_pictures(path: Path, codec: str = "h264") -> str:
    """The pictures of an MP4 in H.264 or H.265, as they are compressed, at their times."""
    return f"( filesrc location={path} ! qtdemux ! {codec}parse ! rtp{codec}pay name=pay0 pt=96 )"


@cache
def _has_gst() -> bool:
    words = [_PYTHON, "-c", _WHAT_IT_NEEDS]
    return Path(_PYTHON).exists() and not subprocess.run(words, capture_output=True).returncode


@contextmanager
def gst_rtsp_server(pictures: str = TEST_PICTURES, **options: object) -> Iterator[str]:
    """Serve pictures by GStreamer's RTSP server; its address without a scheme.

    Args:
        pictures: a pipeline whose payloader is called pay0.
        options: as the server's own: transports ("udp", "tcp" or both with a comma), auth ("basic"
            or "digest", of me and secret), tls (a PEM file with certificate and key).
    """
    if not _has_gst():
        pytest.skip("GStreamer's RTSP server, x264enc or python3-gi is not installed")
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    process = subprocess.Popen(
        [_PYTHON, _GST_SERVER, pictures, *words], stdout=subprocess.PIPE, text=True
    )
    with ending(process):
        assert process.stdout is not None
        yield f"127.0.0.1:{int(process.stdout.readline())}/stream"
