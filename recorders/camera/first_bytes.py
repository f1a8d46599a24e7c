"""Detect a stream's format by its first bytes: names and announced types are often wrong."""

from __future__ import annotations

import re
from collections.abc import Callable

from tunenet_logs.errors import CameraError

# What is taken apart here; all other answers of `format_of` are FFmpeg's names of a format.
MULTIPART = "multipart"

MAX_BYTES = 4096  # by then it is known, or never will be
# A boundary and a part's headers; some senders leave the first boundary out.
_PARTS = re.compile(
    rb"\s{0,8}(?:--[^\r\n]{1,140}\r?\n\s{0,4})?(?:[\w-]{1,40}:[^\n]{0,200}\n){0,8}?"
    rb"content-(?:type: *image/|length: *\d)",
    re.IGNORECASE,
)

# The start code of an H.264 or H.265 unit, and the two bytes behind it.
_UNIT = re.compile(rb"\x00{2,3}\x01([\x00-\x7f])(.)", re.DOTALL)

# Types of the unit that such a stream may begin with: a slice, SEI, SPS, a delimiter.
_H264_FIRST = (1, 5, 6, 7, 9)

_H265_FIRST = (1, 19, 20, 21, 32, 33, 35, 39)  # the same of H.265
# Each packet of MPEG-TS begins with that; so many in their places are no accident.
_TS_SYNC, _TS_BYTES, _TS_PACKETS = b"\x47", 188, 3

# How a playlist begins, of HLS or of MPEG-DASH.
_PLAYLIST = re.compile(
    rb"(?:\xef\xbb\xbf)?(?:#EXTM3U|\s*(?:<\?xml[^>]{0,200}>\s*)?(?:<!--.{0,500}?-->\s*)?<MPD\b)",
    re.DOTALL,
)

# What people give instead of a video, and what helps.
_NO_VIDEO: tuple[tuple[re.Pattern[bytes], str], ...] = (
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


def format_of(start: bytes, *, is_all: bool) -> str | None:
    """Detect the format: MULTIPART, or FFmpeg's name of one; None needs more bytes.

    `is_all` says that no more bytes can be had, or are looked at.

    Raises:
        CameraError: it is no video; without the source's name.
    """
    if _PLAYLIST.match(start):  # before all else: lines may be as regular as packets
        raise CameraError(
            "is a playlist (HLS or MPEG-DASH); let ffmpeg write its video to standard input: "
            "ffmpeg -loglevel error -re -i 'ADDRESS' -c copy -f matroska - | "
            "tunenet-record --camera -"
        )
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
    """Detect an MP4 that can be streamed.

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
    return at > MAX_BYTES


def _is_unit_of(types: tuple[int, ...], shift: int, second: bytes) -> Callable[[bytes], bool]:
    """Make a test for NAL units of `types`; `second` is a header's second byte, if any."""

    def is_such(start: bytes) -> bool:
        found = _UNIT.match(start)
        if found is None or (second and found[2] != second):
            return False
        return (found[1][0] >> shift) & (0x3F if shift else 0x1F) in types

    return is_such


# In the order in which they are tried: the last are the least certain.
_FORMATS: tuple[tuple[str, Callable[[bytes], bool]], ...] = (
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
