"""What a stream of bytes is, by its first: names and announced types are wrong too often."""

from __future__ import annotations

import re
from collections.abc import Callable

from tunenet_logs.errors import CameraError

MULTIPART, PLAYLIST = "multipart", "playlist"
"""What is taken apart here; all other answers of `format_of` are FFmpeg's names of a format."""

MOST_BYTES = 4096
"""By then it is known, or never will be."""

_PARTS = re.compile(
    rb"\s{0,8}(?:--[^\r\n]{1,140}\r?\n\s{0,4})?(?:[\w-]{1,40}:[^\n]{0,200}\n){0,8}?"
    rb"content-(?:type: *image/|length: *\d)",
    re.IGNORECASE,
)
"""A boundary and a part's headers; some senders leave the first boundary out."""

_UNIT = re.compile(rb"\x00{2,3}\x01([\x00-\x7f])(.)", re.DOTALL)
"""The start code of an H.264 or H.265 unit, and the two bytes behind it."""

_H264_FIRST = (1, 5, 6, 7, 9)
"""Types of the unit that such a stream may begin with: a slice, SEI, SPS, a delimiter."""

_H265_FIRST = (1, 19, 20, 21, 32, 33, 35, 39)
"""The same of H.265."""

_TS_SYNC, _TS_BYTES, _TS_PACKETS = b"\x47", 188, 3
"""Each packet of MPEG-TS begins with that; so many in their places are no accident."""

_NO_VIDEO: tuple[tuple[re.Pattern[bytes], str], ...] = (
    (
        re.compile(rb"\s*(?:<\?xml[^>]{0,200}>\s*)?(?:<!--.{0,500}?-->\s*)?<MPD\b", re.DOTALL),
        "is a manifest of MPEG-DASH; give the camera's HLS, RTSP or MJPEG address",
    ),
    (
        re.compile(rb"\s*<"),
        "answers with a web page, not with a video; give the address of the camera's video stream, "
        "as the page's source or the camera's manual has it",
    ),
    (re.compile(rb"v=0\r?\n"), "describes a stream (SDP) and holds none; give its rtsp:// address"),
    (
        re.compile(rb"\x89PNG\r\n|GIF8|BM.{4}\0{4}|RIFF.{4}WEBP", re.DOTALL),
        "gives a single picture; give the address of the camera's video stream",
    ),
)
"""What people give instead of a video, and what helps."""


def format_of(start: bytes, *, is_all: bool) -> str | None:
    """What begins so: MULTIPART, PLAYLIST, or the name of a format that FFmpeg reads.

    Args:
        start: the first bytes.
        is_all: whether no more can be had, or are looked at.

    Returns:
        None where more bytes are needed to tell.

    Raises:
        CameraError: it is no video; without the source's name.
    """
    for name, is_such in _FORMATS:
        if is_such(start):
            return name
    for pattern, what in _NO_VIDEO:
        if pattern.match(start):
            raise CameraError(what)
    if not is_all:
        return None
    if not start.strip():
        raise CameraError(
            "ends before it sends anything; does the camera, or the program that writes, say why?"
        )
    shown = start[:12].decode("latin-1").encode("ascii", "backslashreplace").decode()
    raise CameraError(
        f"is no video that is known here (it begins with {shown!r}); "
        "give the address of the camera's video stream"
    )


def _is_mpegts(start: bytes) -> bool:
    last = _TS_BYTES * (_TS_PACKETS - 1)
    return any(
        start[first : first + last + 1 : _TS_BYTES] == _TS_SYNC * _TS_PACKETS
        for first in range(min(_TS_BYTES, len(start) - last))
    )


def _is_mp4(start: bytes) -> bool:
    """Whether it is MP4, in an order that can be read as it comes.

    Raises:
        CameraError: its pictures come before their index.
    """
    if start[4:8] not in (b"ftyp", b"styp", b"moov", b"moof", b"mdat", b"sidx", b"free", b"wide"):
        return False
    at = 0
    while at + 8 <= len(start):
        size, kind = int.from_bytes(start[at : at + 4], "big"), start[at + 4 : at + 8]
        if kind == b"mdat":
            raise CameraError(
                "is an MP4 whose index stands at its end; download the file and record that"
            )
        if kind in (b"moov", b"moof") or size < 8:
            return True
        at += size
    return at > MOST_BYTES


def _is_unit_of(types: tuple[int, ...], shift: int, second: bytes) -> Callable[[bytes], bool]:
    """Whether a stream begins with a unit of those types; `second` is where its header ends."""

    def is_such(start: bytes) -> bool:
        found = _UNIT.match(start)
        if found is None or (second and found[2] != second):
            return False
        return (found[1][0] >> shift) & (0x3F if shift else 0x1F) in types

    return is_such


_FORMATS: tuple[tuple[str, Callable[[bytes], bool]], ...] = (
    (PLAYLIST, lambda start: start.removeprefix(b"\xef\xbb\xbf").startswith(b"#EXTM3U")),
    ("mjpeg", lambda start: start.startswith(b"\xff\xd8\xff")),
    (MULTIPART, lambda start: _PARTS.match(start) is not None),
    ("matroska", lambda start: start.startswith(b"\x1a\x45\xdf\xa3")),
    ("flv", lambda start: start.startswith(b"FLV\x01")),
    ("mov", _is_mp4),
    ("avi", lambda start: start.startswith(b"RIFF") and start[8:12] == b"AVI "),
    ("ogg", lambda start: start.startswith(b"OggS")),
    ("nut", lambda start: start.startswith(b"nut/multimedia container")),
    ("ivf", lambda start: start.startswith(b"DKIF")),
    ("yuv4mpegpipe", lambda start: start.startswith(b"YUV4MPEG2 ")),
    ("mpeg", lambda start: start.startswith(b"\0\0\1\xba")),
    ("hevc", _is_unit_of(_H265_FIRST, 1, b"\1")),
    ("h264", _is_unit_of(_H264_FIRST, 0, b"")),
    ("mpegts", _is_mpegts),
)
"""In the order in which they are tried: the last are the least certain."""
