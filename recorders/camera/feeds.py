"""Read the bytes of a video from a pipe, TCP or UDP, and detect its format.

Each source of bytes is a `ByteFeed`; `TimedFeed` wraps one, stamps its bytes and lets the first of
them be inspected: names and announced types of formats are often wrong.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import re
import socket
import stat
import struct
import time
from collections import deque
from typing import Protocol
from urllib.parse import urlsplit

from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraError, UsageError
from tunenet_logs.recorders.camera.network import Deadline, connect
from tunenet_logs.recorders.session import closed_on_failure
from tunenet_logs.terminal import short_name

# ---- Format: detected by the first bytes

MULTIPART = "multipart"  # split by our own parser; all other formats have FFmpeg's names
MAX_FORMAT_BYTES = 4096  # by then the format is known, or never will be

# A boundary and a part's headers; some senders leave the first boundary out.
_PARTS = re.compile(
    rb"\s{0,8}(?:--[^\r\n]{1,140}\r?\n\s{0,4})?(?:[\w-]{1,40}:[^\n]{0,200}\n){0,8}?"
    rb"content-(?:type: *image/|length: *\d)",
    re.IGNORECASE,
)

# In the order in which they are tried; the last are the least certain.
_FORMATS: tuple[tuple[str, re.Pattern[bytes]], ...] = (
    ("mjpeg", re.compile(rb"\xff\xd8\xff")),
    (MULTIPART, _PARTS),
    ("matroska", re.compile(rb"\x1a\x45\xdf\xa3")),
    ("flv", re.compile(rb"FLV\x01")),
    ("mov", re.compile(rb".{4}(?:ftyp|styp|moov|moof|mdat|sidx|free|wide)", re.DOTALL)),
    ("avi", re.compile(rb"RIFF.{4}AVI ", re.DOTALL)),
    ("ogg", re.compile(rb"OggS")),
    ("nut", re.compile(rb"nut/multimedia container")),
    ("ivf", re.compile(rb"DKIF")),
    ("yuv4mpegpipe", re.compile(rb"YUV4MPEG2 ")),
    ("mpeg", re.compile(rb"\x00\x00\x01\xba")),
    # A start code, and the header of a NAL unit that a stream may begin with: a slice, SEI, a
    # parameter set, a delimiter (of H.265 the types 1, 19-21, 32, 33, 35, 39; of H.264 1, 5-7, 9).
    ("hevc", re.compile(rb"\x00{2,3}\x01[\x02\x03\x26-\x2b\x40-\x43\x46\x47\x4e\x4f]\x01")),
    ("h264", re.compile(rb"\x00{2,3}\x01[\x01\x05-\x07\t!%-')AE-GIae-gi].", re.DOTALL)),
    # Each packet begins with the sync byte; three in their places are no accident.
    ("mpegts", re.compile(rb".{0,187}?\x47.{187}\x47.{187}\x47", re.DOTALL)),
)

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
    """Detect the format: MULTIPART, or FFmpeg's name of one; None needs more bytes."""
    # `is_all` says that no more bytes can be had, or are looked at.
    if _PLAYLIST.match(start):  # before all else: lines may be as regular as packets
        raise CameraError(
            "is a playlist (HLS or MPEG-DASH); let ffmpeg write its video to standard input: "
            "ffmpeg -loglevel error -re -i 'ADDRESS' -c copy -f matroska - | "
            "tunenet-record --camera -"
        )
    for name, pattern in _FORMATS:
        if pattern.match(start) and (name != "mov" or _is_streamed(start)):
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


def _is_streamed(start: bytes) -> bool:
    """Return whether an MP4's index comes before its pictures."""
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
    return at > MAX_FORMAT_BYTES


# ---- Sources of bytes: a pipe, a TCP connection, datagrams


class ByteFeed(Protocol):
    """Source of a stream's bytes."""

    def read(self, most: int) -> bytes:
        """Read up to `most` bytes as soon as there are any; b"" at the end.

        TimeoutError: none came in time; OSError: it broke; CameraError: the bytes are invalid.
        """
        ...

    def close(self) -> None:
        """Close it, but not while another thread reads: its deadline ends that."""
        ...


class PipeFeed:
    """What a program writes to standard input ("-") or a FIFO, which need not be open there yet."""

    def __init__(self, text: str, deadline: Deadline) -> None:
        self.shown = "standard input" if text == "-" else text
        self._deadline = deadline
        try:
            flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
            self._descriptor = 0 if text == "-" else os.open(text, flags)
            mode = os.fstat(self._descriptor).st_mode
        except OSError as error:
            if text != "-":
                raise CameraError(f"{text}: cannot be read ({error.strerror})") from error
            raise UsageError(
                "--camera -: standard input is closed; put the program that writes the video "
                "before it"
            ) from error
        self.is_written_to = not stat.S_ISREG(mode)  # while it is read; else it is a file
        if text != "-" and not stat.S_ISFIFO(mode):  # it was exchanged meanwhile
            self.close()
            raise CameraError(f"{text}: is no pipe any more; try again")
        if text == "-" and os.isatty(0):
            raise UsageError(
                "--camera -: reads a video from standard input, which is a terminal; put the "
                "program that writes it before: gst-launch-1.0 -q ... ! matroskamux ! fdsink | "
                "tunenet-record --camera -"
            )

    def read(self, most: int) -> bytes:
        """Read what was written."""
        return os.read(self._descriptor, most) if self._deadline.is_ready(self._descriptor) else b""

    def close(self) -> None:
        """Close the FIFO; standard input is not ours."""
        if self._descriptor != 0:
            os.close(self._descriptor)


class TcpFeed:
    """What comes from a camera that sends its video to whoever connects to tcp://HOST:PORT."""

    def __init__(self, address: Address, deadline: Deadline) -> None:
        parts = urlsplit(address.url)
        more = parts.path.strip("/") or parts.query or address.full_url != address.url
        if parts.port is None or more:
            raise UsageError(
                "--camera: a tcp address has a host and a port alone; "
                "write it like tcp://192.168.1.20:5000"
            )
        self._socket = connect(parts.hostname or "", parts.port, deadline, None)

    def read(self, most: int) -> bytes:
        """Read what was received."""
        data = bytearray(most)
        return bytes(data[: self._socket.recv_into(data)])

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


# Asked of the kernel for datagrams that wait: a key picture comes as hundreds of them at once.
RECEIVE_BYTES = 8 * 1024 * 1024

_ANY_4, _ANY_6 = "0.0.0.0", "::"  # noqa: S104 (which of its addresses a camera knows is open)


class UdpFeed:
    """Datagrams (MPEG-TS) to a port of this machine, from the first host that sends any.

    udp://@:PORT takes all that comes to this machine; udp://HOST:PORT has its own address, the
    sender's, or that of a multicast group.
    """

    def __init__(self, text: str, deadline: Deadline) -> None:
        found = re.fullmatch(r"(?i)udp://@?(\[[0-9a-f:.]+\]|[a-z0-9.-]*):(\d{1,5})/?", text)
        if found is None or not 0 < int(found[2]) < 65536:
            raise UsageError(
                "--camera: that is no udp address; write udp://@:5000 for what is sent to this "
                "machine, or udp://239.1.2.3:5000 for a multicast group"
            )
        self._deadline = deadline
        self._sender: str | None = None
        self._rest = b""
        try:
            self._socket = self._bound(found[1].strip("[]"), int(found[2]))
        except OSError as error:
            why = error.strerror or str(error)
            raise CameraError(
                f"{text}: cannot be listened to ({why}); is the port free, and the address right?"
            ) from error
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        self._socket.setblocking(False)

    def read(self, most: int) -> bytes:
        """Read a datagram; what is left of it comes with the next read."""
        data = self._rest
        while not data:
            if not self._deadline.is_ready(self._socket):
                return b""
            data, (sender, *_) = self._socket.recvfrom(65536)
            if not data or sender != (self._sender or sender):
                data = b""
                continue
            if self._sender is None and data[0] & 0xC0 == 0x80:  # of MPEG-TS it is 0x47
                raise CameraError(
                    "sends RTP, which only its description (SDP) explains; give the camera's "
                    "rtsp:// address, or take it apart with GStreamer and pipe it in (--camera -)"
                )
            self._sender = sender
        self._rest = data[most:]
        return data[:most]

    def close(self) -> None:
        """Close the port."""
        self._socket.close()

    def _bound(self, host: str, port: int) -> socket.socket:
        """Bind a socket for a host: this one, a sender or a multicast group."""
        address = socket.getaddrinfo(host or _ANY_4, port, type=socket.SOCK_DGRAM)[0]
        family, place = address[0], address[4]
        group = ipaddress.ip_address(str(place[0]).partition("%")[0])
        listening = socket.socket(family, socket.SOCK_DGRAM)
        with closed_on_failure(listening):
            if group.is_multicast:
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                listening.bind(place)  # the group's address: nothing else that comes to the port
                if group.version == 4:
                    join = socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP
                    listening.setsockopt(*join, group.packed + socket.inet_aton(_ANY_4))
                else:
                    join = socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP
                    listening.setsockopt(*join, group.packed + struct.pack("@I", 0))
                return listening
            try:
                listening.bind(place)
            except OSError as error:
                if error.errno != errno.EADDRNOTAVAIL:
                    raise
                listening.bind((_ANY_6 if family == socket.AF_INET6 else _ANY_4, port))
                self._sender = str(place[0])  # it is another machine's: who sends
        return listening


# ---- Timed feed: when each byte arrived, and a look at the first ones

# Of one picture, and from one to the next: a sender without an end must not fill the memory. A JPEG
# of 36 megapixels has 30 MB.
MAX_PICTURE_BYTES = 64 * 1024 * 1024

_JPEG = b"\xff\xd8\xff"  # a JPEG's begin; inside a JPEG only an embedded thumbnail has it


class TimedFeed:
    """A feed with arrival times, whose first bytes can be inspected."""

    def __init__(self, feed: ByteFeed, deadline: Deadline, timeout_s: float) -> None:
        self.deadline = deadline  # of all that `feed` reads; renewed with each picture
        self.timeout_s = timeout_s  # the longest from one picture to the next
        self._feed = feed  # closed with this
        self._held = bytearray()
        self._at_end = False
        self._given = 0
        self._most = MAX_PICTURE_BYTES
        # Of each read, the position behind its last byte and when it was here [monotonic ns]: of
        # far more reads than a library reads ahead.
        self._times: deque[tuple[int, int]] = deque(maxlen=1 << 16)

    def format(self) -> str:
        """Detect the stream's format by its first bytes, which stay to be read."""
        while True:
            is_all = self._at_end or len(self._held) >= MAX_FORMAT_BYTES
            found = format_of(bytes(self._held[:MAX_FORMAT_BYTES]), is_all=is_all)
            if found is not None:
                return found
            self._held += self._take(MAX_FORMAT_BYTES - len(self._held))

    def is_one_jpeg(self) -> bool:
        """Return whether a JPEG stream ends before a second JPEG; its bytes stay."""
        looked = len(_JPEG)
        while self._held.find(_JPEG, looked - len(_JPEG) + 1) < 0:
            if self._at_end or len(self._held) > MAX_PICTURE_BYTES:
                return self._at_end
            looked = len(self._held)
            self._held += self._take(64 * 1024)
        return False

    def read(self, most: int) -> bytes:
        """Read as `ByteFeed.read` does."""
        if self._given > self._most:
            raise CameraError(f"sends {MAX_PICTURE_BYTES >> 20} MiB without a picture")
        data = bytes(self._held[:most]) or self._take(most)
        del self._held[: len(data)]
        self._given += len(data)
        return data

    def got_picture(self) -> None:
        """Renew the deadline after a picture."""
        self._most = self._given + MAX_PICTURE_BYTES
        self.deadline.renew(self.timeout_s)

    def arrived_ns(self, position: int | None = None) -> int:
        """Return when a byte arrived [monotonic ns]: the last read, or at `position`, in order."""
        if position is None:
            position = self._given - 1
        while len(self._times) > 1 and self._times[0][0] <= position:
            self._times.popleft()
        return self._times[0][1] if self._times else time.monotonic_ns()

    def why_broken(self, error: OSError) -> str:
        """Describe why the stream broke."""
        if isinstance(error, TimeoutError):
            what = "no whole picture" if self.deadline.is_over else "no data"
            return f"{what} for {self.timeout_s:.1f} s"
        why = error.strerror or str(error) or type(error).__name__
        return f"the connection to the camera broke ({short_name(why)})"

    def close(self) -> None:
        """Close the feed."""
        self._feed.close()

    def _take(self, most: int) -> bytes:
        data = b"" if self._at_end else self._feed.read(most)
        self._at_end = not data
        if data:
            self._times.append((self._given + len(self._held) + len(data), time.monotonic_ns()))
        return data
