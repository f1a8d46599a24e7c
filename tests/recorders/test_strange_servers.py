"""Servers that others wrote, one for each way in which a video comes."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import BIN
from tests.recorders.films import film
from tests.recorders.free_port import free_port
from tests.recorders.live_wait import LAST_RESORT_S, ending
from tests.recorders.mjpeg_camera import times_in
from tests.recorders.nginx_server import nginx_server
from tunenet_logs.errors import CameraError
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.sources import open_source

pytestmark = pytest.mark.live

COUNT = 45
SOME = 20  # of the pictures of a server that has no end and waits for nobody
# Before a program that refuses to be root's.
AS_NOBODY = ["runuser", "-u", "nobody", "--"] if os.geteuid() == 0 else []

GST = ["gst-launch-1.0", "-q", "videotestsrc", "is-live=true", f"num-buffers={COUNT}", "!"]
GST += ["video/x-raw,width=160,height=120,framerate=30/1", "!"]
GST_264 = ["x264enc", "tune=zerolatency", "key-int-max=5", "!"]
FFMPEG = ["ffmpeg", "-loglevel", "error", "-re", "-f", "lavfi", "-i", "testsrc2=s=160x120:r=30"]
FFMPEG += ["-t", str(COUNT / 30), "-threads", "1"]
SLOW = pytest.mark.slow
FFMPEG_264 = ["-c:v", "libx264", "-preset", "ultrafast", "-tune", "zerolatency", "-g", "5"]


@pytest.fixture(scope="module")
def gst() -> list[str]:
    """The beginning of a pipeline, where GStreamer has all that those here need."""
    inspect = shutil.which("gst-inspect-1.0")
    for name in ("x264enc", "matroskamux", "mpegtsmux", "jpegenc", "tcpserversink"):
        if inspect is None or subprocess.run([inspect, "--exists", name], check=False).returncode:
            pytest.skip(f"GStreamer's {name} is not installed")
    return GST


def needs(*names: str) -> pytest.MarkDecorator:
    missing = [name for name in names if shutil.which(name) is None]
    return pytest.mark.skipif(bool(missing), reason=f"{', '.join(missing)} is not installed")


@contextmanager
def running(words: list[str]) -> Iterator[None]:
    """A server, until it is no longer needed."""
    none = subprocess.DEVNULL
    with ending(subprocess.Popen(words, stdin=none, stdout=none, stderr=none, text=True)):
        yield


def frames_of(text: str, most: int | None = None) -> tuple[int, str]:
    """How many pictures a server that may have to start sends, and as what.

    Args:
        most: after which it is left alone; None for one that ends.
    """
    until = time.monotonic() + LAST_RESORT_S
    while True:
        try:
            source = open_source(text, CameraOptions(stall_s=LAST_RESORT_S))
            break
        except CameraError as error:
            if "cannot be reached" not in str(error) or time.monotonic() > until:
                raise
            time.sleep(0.05)
    shots = list(islice(source.frames(), most))
    source.close()
    return len(shots), shots[0].frame.encoding


@pytest.mark.parametrize(
    ("coded", "is_told"),
    [
        ([*GST_264, "matroskamux"], True),
        ([*GST_264, "mpegtsmux"], True),
        pytest.param(
            [*GST_264, "mp4mux", "fragment-duration=200", "streamable=true"], True, marks=SLOW
        ),
        pytest.param(["jpegenc", "!", "matroskamux"], True, marks=SLOW),
        pytest.param(["jpegenc", "!", "multipartmux"], False, marks=SLOW),
        pytest.param(["jpegenc"], False, marks=SLOW),
    ],
)
def test_a_pipeline_of_gstreamer_is_a_camera(
    gst: list[str], tmp_path: Path, coded: list[str], is_told: bool
):
    sender = subprocess.Popen([*gst, *coded, "!", "fdsink"], stdout=subprocess.PIPE)
    done = subprocess.run(
        [BIN / "tunenet-record", "--camera", "-", "-o", "a.mcap"],
        stdin=sender.stdout, cwd=tmp_path, capture_output=True, text=True, check=False,
        timeout=LAST_RESORT_S,
    )  # fmt: skip
    assert sender.stdout is not None
    sender.stdout.close()
    sender.wait()
    assert f" {COUNT} frames captured, {COUNT} written, 0 dropped" in done.stdout, done.stderr
    if is_told:  # to a container's millisecond
        stamps_ns = np.sort([stamp_ns for stamp_ns, _ in times_in(tmp_path / "a.mcap")])
        assert np.allclose(np.diff(stamps_ns), 1e9 / 30, atol=1.1e6)


@pytest.mark.parametrize(
    ("coded", "encoding"),
    [
        ([*GST_264, "matroskamux", "streamable=true"], "h264"),
        pytest.param([*GST_264, "mpegtsmux"], "h264", marks=SLOW),
        (["jpegenc", "!", "multipartmux"], "jpeg"),
    ],
)
def test_gstreamer_over_tcp(gst: list[str], coded: list[str], encoding: str):
    port = free_port()
    endless = [word for word in gst if not word.startswith("num-buffers")]
    with running([*endless, *coded, "!", "tcpserversink", "host=127.0.0.1", f"port={port}"]):
        assert frames_of(f"tcp://127.0.0.1:{port}", SOME) == (SOME, encoding)


@needs("ffmpeg")
@pytest.mark.parametrize(
    ("words", "encoding"),
    [
        ([*FFMPEG_264, "-f", "mpegts", "tcp://127.0.0.1:{port}?listen"], "h264"),
        pytest.param(
            [*FFMPEG_264, "-f", "h264", "tcp://127.0.0.1:{port}?listen"], "h264", marks=SLOW
        ),
        ([*FFMPEG_264, "-f", "matroska", "-listen", "1", "http://127.0.0.1:{port}/"], "h264"),
        pytest.param(
            [*FFMPEG_264, "-f", "flv", "-listen", "1", "http://127.0.0.1:{port}/"],
            "h264",
            marks=SLOW,
        ),
        (["-c:v", "mjpeg", "-f", "mpjpeg", "-listen", "1", "http://127.0.0.1:{port}/"], "jpeg"),
        pytest.param(
            ["-c:v", "mjpeg", "-f", "mjpeg", "-listen", "1", "http://127.0.0.1:{port}/"],
            "jpeg",
            marks=SLOW,
        ),
    ],
)
def test_ffmpeg_as_a_server(words: list[str], encoding: str):
    port = free_port()
    place = [word.format(port=port) for word in words]
    with running([*FFMPEG, *place]):
        scheme = "tcp" if place[-1].startswith("tcp") else "http"
        assert frames_of(f"{scheme}://127.0.0.1:{port}") == (COUNT, encoding)


@pytest.mark.parametrize("kind", ["mpegts", "matroska", "flv"])
def test_a_film_from_nginx(tmp_path: Path, kind: str):
    (tmp_path / "film").write_bytes(film(kind))
    with nginx_server(tmp_path, f"root {tmp_path};") as place:
        assert frames_of(f"http://{place}/film") == (30, "h264")


@needs("cvlc", *AS_NOBODY[:1])
@pytest.mark.parametrize("mux", ["ts", "mpjpeg"])
def test_vlc(mux: str):
    port = free_port()
    codec, encoding = ("mjpeg", "jpeg") if mux == "mpjpeg" else ("libx264", "h264")
    with tempfile.TemporaryDirectory(dir="/tmp") as name:  # which is open to all
        home = Path(name)
        home.chmod(0o777)
        (home / "film.mkv").write_bytes(film("matroska", codec, count=120))
        words = [*AS_NOBODY, "env", f"HOME={home}", "cvlc", "-q", "-I", "dummy", "--no-audio"]
        sout = f"#http{{mux={mux},dst=127.0.0.1:{port}/x}}"
        with running([*words, "--loop", str(home / "film.mkv"), "--sout", sout]):
            assert frames_of(f"http://127.0.0.1:{port}/x", SOME) == (SOME, encoding)
