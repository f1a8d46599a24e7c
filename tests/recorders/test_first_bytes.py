"""A stream is known by its first bytes, whatever its name and its announced type are."""

from __future__ import annotations

import pytest

from tests.recorders.films import film
from tests.recorders.mjpeg_camera import picture
from tunenet_logs.errors import CameraError
from tunenet_logs.recorders.camera.feeds import MAX_FORMAT_BYTES, MULTIPART, format_of


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (picture(1), "mjpeg"),
        (b"--frame\r\nContent-Type: image/jpeg\r\n\r\n", MULTIPART),
        (b"\r\n--x\r\nX-Timestamp: 1.5\r\nContent-Length: 12\r\n\r\n", MULTIPART),
        (b"Content-type: image/jpeg\n\n", MULTIPART),
        (film("mpegts"), "mpegts"),
        (film("mpegts")[100:], "mpegts"),
        (film("matroska"), "matroska"),
        (film("flv"), "flv"),
        (film("mp4", movflags="faststart"), "mov"),
        (film("mp4", movflags="frag_keyframe+empty_moov"), "mov"),
        (film("avi"), "avi"),
        (film("h264"), "h264"),
        (b"\0\0\1\x40\1\x0c", "hevc"),
        (b"\0\0\0\1\x46\1\x50", "hevc"),
        (b"\0\0\0\1\x41\x9a", "h264"),
        (b"\0\0\1\xba\x44", "mpeg"),
        (b"YUV4MPEG2 W64 H48\n", "yuv4mpegpipe"),
    ],
)
def test_what_begins_so(start: bytes, kind: str):
    assert format_of(start[:MAX_FORMAT_BYTES], is_all=True) == kind


def test_a_few_bytes_wait_for_more_and_never_mislead():
    for kind in ("mpegts", "matroska", "flv", "h264", "avi"):
        whole = film(kind)[:MAX_FORMAT_BYTES]
        seen = [format_of(whole[:count], is_all=False) for count in range(1, 600)]
        assert set(seen) <= {None, kind}
        assert seen[-1] == kind


@pytest.mark.parametrize(
    ("start", "says"),
    [
        (b"", "ends before it sends anything"),
        (b"\r\n \r\n", "ends before it sends anything"),
        (b"<!DOCTYPE html><html>", "web page"),
        (b"<?xml version='1.0'?>\n<MPD xmlns='x'>", r"playlist \(HLS or MPEG-DASH\)"),
        (b"\xef\xbb\xbf#EXTM3U\n", r"playlist \(HLS or MPEG-DASH\)"),
        ((b"#EXTM3U".ljust(93, b"G") + b"\n") * 6, "playlist"),  # as regular as MPEG-TS
        (b"v=0\r\no=- 0 0 IN IP4 1.2.3.4\r\n", "SDP"),
        (b"\x89PNG\r\n\x1a\n", "single picture"),
        (b"ID3\4\0\0\0\0", "is no video that is known here"),
        (film("mp4"), "index stands at its end"),
    ],
)
def test_what_is_no_video_is_named(start: bytes, says: str):
    with pytest.raises(CameraError, match=says):
        format_of(start[:MAX_FORMAT_BYTES], is_all=True)
