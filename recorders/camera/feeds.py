"""Read the bytes of a video from a pipe, TCP or UDP, and detect its format.

Each source of bytes is a `ByteFeed`; `TimedFeed` wraps one, stamps its bytes and lets the first of
them be inspected: names and announced types of formats are often wrong.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import re
import select
import socket
import stat
import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraError, UsageError
from tunenet_logs.recorders.camera.network import Deadline, connect, host_and_port
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

# The start code of an H.264 or H.265 NAL unit, and the two bytes behind it.
_UNIT = re.compile(rb"\x00{2,3}\x01([\x00-\x7f])(.)", re.DOTALL)

# Types of the NAL unit that such a stream may begin with: a slice, SEI, SPS, a delimiter.
_H264_FIRST = (1, 5, 6, 7, 9)
_H265_FIRST = (1, 19, 20, 21, 32, 33, 35, 39)

# Each packet of MPEG-TS begins with the sync byte; so many in their places are no accident.
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
    return at > MAX_FORMAT_BYTES


def _is_unit_of(types: tuple[int, ...], shift: int, second: bytes) -> Callable[[bytes], bool]:
    """Make a test for NAL units of `types`; `second` is a header's second byte, if any."""

    def is_such(start: bytes) -> bool:
        found = _UNIT.match(start)
        if found is None or (second and found[2] != second):
            return False
        return (found[1][0] >> shift) & (0x3F if shift else 0x1F) in types

    return is_such


# In the order in which they are tried; the last are the least certain.
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


# ---- Pipe: standard input or a FIFO, so that any program that writes video is a camera

STANDARD_INPUT = "-"  # what stands for it on the command line


class PipeFeed:
    """The bytes that a program writes to a pipe.

    Args:
        descriptor: of the pipe; closed with the feed, but for standard input.
        deadline: of its reads.
    """

    def __init__(self, descriptor: int, deadline: Deadline) -> None:
        self._descriptor = descriptor
        self._deadline = deadline
        self._wakes, self._woken = socket.socketpair()
        deadline.watch(self._wakes)

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        waits_for = [self._descriptor, self._woken]
        ready, _, _ = select.select(waits_for, [], [], self._deadline.next_s())
        if self._woken in ready:
            return b""
        if not ready:
            raise TimeoutError("nothing was written")
        return os.read(self._descriptor, most)

    def close(self) -> None:
        """See `ByteFeed`."""
        self._wakes.close()
        self._woken.close()
        if self._descriptor != 0:
            os.close(self._descriptor)


@dataclass(frozen=True)
class Pipe:
    """An open pipe.

    Attributes:
        is_written_to: whether a program writes to it while it is read; else it is a file.
    """

    descriptor: int
    shown: str
    is_written_to: bool = True


def opened_pipe(text: str) -> Pipe:
    """Open standard input or a FIFO, without waiting for its writer.

    Raises:
        UsageError: nothing is piped into this command.
        CameraError: it cannot be opened.
    """
    if text == STANDARD_INPUT:
        return _standard_input()
    try:
        descriptor = os.open(text, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise CameraError(f"{text}: cannot be read ({error.strerror})") from error
    if not stat.S_ISFIFO(os.fstat(descriptor).st_mode):  # it was exchanged meanwhile
        os.close(descriptor)
        raise CameraError(f"{text}: is no pipe any more; try again")
    return Pipe(descriptor, text)


def _standard_input() -> Pipe:
    try:
        mode = os.fstat(0).st_mode
    except OSError as error:
        raise UsageError(
            "--camera -: standard input is closed; put the program that writes the video before it"
        ) from error
    if os.isatty(0):
        raise UsageError(
            "--camera -: reads a video from standard input, which is a terminal; put the program "
            "that writes it before: gst-launch-1.0 -q ... ! matroskamux ! fdsink | tunenet-record "
            "--camera -"
        )
    return Pipe(0, "standard input", is_written_to=not stat.S_ISREG(mode))


# ---- TCP: a camera that sends its video to whoever connects


class TcpFeed:
    """The bytes of one TCP connection.

    Args:
        deadline: of connecting and of all reads.

    Raises:
        UsageError: the address is not just host and port.
        CameraError: nothing answers there.
        TimeoutError: it does not answer in time.
    """

    def __init__(self, address: Address, deadline: Deadline) -> None:
        host, port = host_and_port(address)
        self._socket = connect(host, port, deadline, None)

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        data = bytearray(most)
        return bytes(data[: self._socket.recv_into(data)])

    def close(self) -> None:
        """See `ByteFeed`."""
        self._socket.close()


# ---- Timed feed: when each byte arrived, and a look at the first ones

# Bytes from one picture to the next: a sender without an end must not fill the memory.
_MAX_BYTES_WITHOUT_PICTURE = 64 * 1024 * 1024

_JPEG = b"\xff\xd8\xff"  # a JPEG's begin; inside a JPEG only an embedded thumbnail has it
_LOOK_BYTES = 64 * 1024  # read at once while the second JPEG is sought
_MAX_SNAPSHOT_BYTES = 16 * 1024 * 1024  # searched for a second JPEG; what is longer is a stream
_MAX_READ_TIMES = 1 << 16  # reads whose times are kept: far more than a library reads ahead


class ByteFeed(Protocol):
    """Source of a stream's bytes."""

    def read(self, most: int) -> bytes:
        """Read up to `most` bytes as soon as there are any; b"" at the end.

        Raises:
            TimeoutError: none came in time.
            OSError: the connection broke.
            CameraError: the bytes are invalid.
        """
        ...

    def close(self) -> None:
        """Close it, but not while another thread reads: its deadline ends that."""
        ...


class TimedFeed:
    """A feed with arrival times, whose first bytes can be inspected.

    Args:
        feed: closed with this.
        deadline: of all that `feed` reads; renewed with each picture.
        timeout_s: the longest from one picture to the next.
    """

    def __init__(self, feed: ByteFeed, deadline: Deadline, timeout_s: float) -> None:
        self.deadline = deadline
        self.timeout_s = timeout_s
        self._feed = feed
        self._held = bytearray()
        self._at_end = False
        self._given = 0
        self._most = _MAX_BYTES_WITHOUT_PICTURE
        self._times: deque[tuple[int, int]] = deque(maxlen=_MAX_READ_TIMES)
        """Of each read, the position behind its last byte and when it was here [monotonic ns]."""

    def format(self) -> str:
        """Detect the stream's format by its first bytes, which stay to be read.

        Raises:
            CameraError: it is no video.
            OSError: see `ByteFeed.read`.
        """
        while True:
            is_all = self._at_end or len(self._held) >= MAX_FORMAT_BYTES
            found = format_of(bytes(self._held[:MAX_FORMAT_BYTES]), is_all=is_all)
            if found is not None:
                return found
            self._held += self._take(MAX_FORMAT_BYTES - len(self._held))

    def is_one_jpeg(self) -> bool:
        """Return whether a JPEG stream ends before a second JPEG; its bytes stay.

        Raises:
            OSError: see `ByteFeed.read`.
        """
        looked = len(_JPEG)
        while self._held.find(_JPEG, looked - len(_JPEG) + 1) < 0:
            if self._at_end or len(self._held) > _MAX_SNAPSHOT_BYTES:
                return self._at_end
            looked = len(self._held)
            self._held += self._take(_LOOK_BYTES)
        return False

    def read(self, most: int) -> bytes:
        """Read as `ByteFeed.read` does.

        Raises:
            CameraError: far more came than a picture holds.
        """
        if self._given > self._most:
            raise CameraError(f"sends {_MAX_BYTES_WITHOUT_PICTURE >> 20} MiB without a picture")
        data = bytes(self._held[:most]) or self._take(most)
        del self._held[: len(data)]
        self._given += len(data)
        return data

    def got_picture(self) -> None:
        """Renew the deadline after a picture."""
        self._most = self._given + _MAX_BYTES_WITHOUT_PICTURE
        self.deadline.renew(self.timeout_s)

    def arrived_ns(self, position: int | None = None) -> int:
        """Return when a byte arrived [monotonic ns]: the last read, or at `position`, in order.

        Args:
            position: counted from the stream's first byte; None for the last that was read.
        """
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


# ---- UDP: video in datagrams (MPEG-TS), unicast or multicast

_UDP_ADDRESS = re.compile(r"udp://@?(\[[0-9a-f:.]+\]|[a-z0-9.-]*):(\d{1,5})/?", re.IGNORECASE)
_MAX_DATAGRAM_BYTES = 65536
# Asked of the kernel for datagrams that wait: a key picture comes as hundreds of them at once.
_RECEIVE_BYTES = 4 * 1024 * 1024

_ANY_4, _ANY_6 = "0.0.0.0", "::"  # noqa: S104 (which of its addresses a camera knows is open)
_RTP = 0x80  # the first byte of an RTP packet; MPEG-TS has 0x47 there


class UdpFeed:
    """Datagrams to a port of this machine, from the first host that sends any.

    Args:
        text: udp://@:PORT for all that comes to this machine, udp://HOST:PORT with its own address,
            the sender's, or that of a multicast group.
        deadline: of all reads.

    Raises:
        UsageError: the address is invalid.
        CameraError: the port is taken, or the host unknown.
    """

    def __init__(self, text: str, deadline: Deadline) -> None:
        found = _UDP_ADDRESS.fullmatch(text)
        if found is None or not 0 < int(found[2]) < 65536:
            raise UsageError(
                "--camera: that is no udp address; write udp://@:5000 for what is sent to this "
                "machine, or udp://239.1.2.3:5000 for a multicast group"
            )
        host, port = found[1].strip("[]"), int(found[2])
        self._deadline = deadline
        self._sender: str | None = None
        self._rest = b""
        try:
            self._socket = self._bound(host, port)
        except OSError as error:
            why = error.strerror or str(error)
            raise CameraError(
                f"{text}: cannot be listened to ({why}); is the port free, and the address right?"
            ) from error
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        self._socket.setblocking(False)
        self._wakes, self._woken = socket.socketpair()
        deadline.watch(self._wakes)

    def read(self, most: int) -> bytes:
        """See `ByteFeed`; the rest of a datagram comes with the next read."""
        data = self._rest or self._datagram()
        self._rest = data[most:]
        return data[:most]

    def close(self) -> None:
        """See `ByteFeed`."""
        self._wakes.close()
        self._woken.close()
        self._socket.close()

    def _datagram(self) -> bytes:
        while True:
            ready, _, _ = select.select(
                [self._socket, self._woken], [], [], self._deadline.next_s()
            )
            if self._woken in ready:
                return b""
            if not ready:
                raise TimeoutError("no datagram came")
            data, (sender, *_) = self._socket.recvfrom(_MAX_DATAGRAM_BYTES)
            if not data or sender != (self._sender or sender):
                continue
            if self._sender is None and data[0] & 0xC0 == _RTP:
                raise CameraError(
                    "sends RTP, which only its description (SDP) explains; give the camera's "
                    "rtsp:// address, or take it apart with GStreamer and pipe it in (--camera -)"
                )
            self._sender = sender
            return data

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
                _join(listening, group)
                return listening
            try:
                listening.bind(place)
            except OSError as error:
                if error.errno != errno.EADDRNOTAVAIL:
                    raise
                listening.bind((_ANY_6 if family == socket.AF_INET6 else _ANY_4, port))
                self._sender = str(place[0])  # it is another machine's: who sends
        return listening


def _join(listening: socket.socket, group: ipaddress.IPv4Address | ipaddress.IPv6Address) -> None:
    if isinstance(group, ipaddress.IPv4Address):
        request = group.packed + socket.inet_aton(_ANY_4)
        listening.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
    else:
        listening.setsockopt(
            socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group.packed + struct.pack("@I", 0)
        )
