"""What people write for a camera's address, and what is a file's name."""

from __future__ import annotations

from pathlib import Path

import pytest

from tunenet_logs.errors import CameraError, UsageError
from tunenet_logs.recorders.camera.network import with_scheme
from tunenet_logs.recorders.camera.sources import open_source


@pytest.mark.parametrize(
    "text",
    [
        "192.168.1.20:8080/video", "192.168.1.20", "192.168.1.20/video.mp4", "[fe80::1]:8080/video",
        "cam.local/stream", "cam.local:8080", "camera:81/", "user:secret@cam/video",
        "admin@10.0.0.5/live",
    ],
)  # fmt: skip
def test_an_address_needs_no_scheme(text: str):
    assert with_scheme(text) == f"http://{text}"


@pytest.mark.parametrize(
    "text",
    [
        "video.mp4", "my.film.mp4", "clips/video.mp4", "clips.2024/video.mp4", "old.films/drop.mp4",
        "cam.local", "12:30.mp4", "./cam.local/x", "../x", "0", "/dev/video0", "-",
        "rtsp://cam/x", "1.2.3.4.mp4",
    ],
)  # fmt: skip
def test_a_name_stays_one(text: str):
    assert with_scheme(text) == text


def test_a_file_that_is_there_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "192.168.1.20").write_bytes(b"")
    (tmp_path / "cam.local").mkdir()
    assert with_scheme("192.168.1.20") == "192.168.1.20"
    assert with_scheme("cam.local/drop") == "cam.local/drop"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("video.mp4", "no such file"),
        ("srt://1.2.3.4:5000", r"srtsrc uri=srt://\.\.\. ! fdsink \| tunenet-record --camera -"),
        ("rtp://@:5004", "rtpjitterbuffer ! rtph264depay"),
        ("rtmp://cam/live", r"ffmpeg .* -i rtmp://\.\.\."),
        ("file:///etc/passwd", "file:// is not recorded; there is http, https, rtsp"),
        ("tcp://127.0.0.1", "a host and a port alone"),
        ("tcp://a:b@127.0.0.1:5000", "a host and a port alone"),
        ("tcp://127.0.0.1:5000/x", "a host and a port alone"),
        ("udp://127.0.0.1", "no udp address"),
        ("udp://@:99999", "no udp address"),
        ("cam:99999/video", "no http address"),
    ],
)
def test_what_cannot_be_opened_is_told_with_its_remedy(text: str, says: str):
    with pytest.raises((UsageError, CameraError), match=says):
        open_source(text)


def test_a_password_is_never_shown():
    with pytest.raises((UsageError, CameraError)) as caught:
        open_source("tcp://user:secret@127.0.0.1:5000")
    assert "secret" not in str(caught.value)
