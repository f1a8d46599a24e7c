"""Read a camera that speaks RTSP (RFC 2326), over TCP, TLS or UDP.

FFmpeg can depacketize video. But it follows a camera to any host, trusts any certificate, and knows
one digest of five. So `RtspClient` talks to the camera, and `RtspRelay` serves the packets on this
machine alone to FFmpeg, which `RtspStream` reads.
"""

from __future__ import annotations

import math
import re
import secrets
import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from urllib.parse import urlsplit

from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraAwayError, CameraError
from tunenet_logs.recorders.camera.feeds import RECEIVE_BYTES
from tunenet_logs.recorders.camera.network import (
    Deadline,
    Login,
    Transport,
    Trust,
    answering,
    connect,
    refused,
    sent_on,
)
from tunenet_logs.recorders.camera.streams import NOT_PARSED, PacketStream
from tunenet_logs.recorders.session import closed_on_failure
from tunenet_logs.terminal import short_name

# ---- RTP: join fragmented NAL units into fewer and larger packets
# Each costs FFmpeg six calls of the kernel and us a Python object; a 4K picture comes in fifty.

# An interleaved packet: "$", channel, length; and of RTP (RFC 3550) its first byte, marker and
# kind, number, time and sender.
_PACKET = struct.Struct(">BBHBBHII")

_IS_FIRST, _IS_LAST = 0x80, 0x40  # bits of the FU header: a fragment begins, or ends, its NAL unit

# By coding (RFC 6184, 7798): bytes before a fragment's data, the NAL unit's header and the FU
# header; the bits of a payload's first byte that hold its type; and the type of a fragment.
_FRAGMENTS = {"H264": (2, 0x1F, 28), "H265": (3, 0x7E, 49 << 1)}


class FragmentJoiner:
    """Joins consecutive fragments (FU) of one NAL unit (RFC 6184, 7798).

    Packets are renumbered, so that a sequence number is missing where a packet is, and nowhere
    else. Unknown packets are passed on as they came.
    """

    def __init__(self, coding: str, channel: int) -> None:
        self._head_bytes, self._mask, self._kind = _FRAGMENTS.get(coding, (0, 0, 0))
        self._channel = channel  # on which the pictures come
        self._joined = 0
        self._first_ticks: int | None = None
        self._last_ticks = 0
        self._is_whole = True

    def is_open(self, ticks: int | None) -> bool:
        """Return whether the picture at `ticks` (first: 0) is the last, its end missing."""
        if ticks is None or self._first_ticks is None or self._is_whole:
            return False
        return self._first_ticks + ticks & 0xFFFFFFFF == self._last_ticks

    def joined(self, packets: memoryview) -> bytearray | memoryview:
        """Join interleaved packets, each whole, into fewer."""
        if not self._head_bytes:
            return packets
        out = bytearray()
        begun_at, follows = -1, (0, 0, 0, b"")
        payload = _PACKET.size
        data_at = payload + self._head_bytes
        end = 0
        while (at := end) < len(packets):
            end = at + 4 + (packets[at + 2] << 8 | packets[at + 3])
            if end - at < data_at or packets[at + 1] != self._channel:
                out += packets[at:end]
                begun_at = -1
                continue
            _, _, _, plain, kind, number, ticks, sender = _PACKET.unpack_from(packets, at)
            if self._first_ticks is None:
                self._first_ticks = ticks
            self._last_ticks, self._is_whole = ticks, bool(kind & 0x80)  # its marker
            head = bytes(packets[at + payload : at + data_at])
            fragment = head[-1]
            # Nothing stands between the head and the payload of a plain packet.
            is_fragment = plain == 0x80 and head[0] & self._mask == self._kind
            unit = head[:-1] + bytes((fragment & 0x3F,))
            if (
                is_fragment
                and begun_at >= 0
                and follows == (number, ticks, sender, unit)
                and not fragment & _IS_FIRST
                # A joined packet's length is stated in two bytes.
                and len(out) - begun_at + end - at < 60_000
            ):
                out += packets[at + data_at : end]
                out[begun_at + 5] |= kind & 0x80
                if not out[begun_at + data_at - 1] & _IS_FIRST:  # both in one would be an error
                    out[begun_at + data_at - 1] |= fragment & _IS_LAST
                struct.pack_into(">H", out, begun_at + 2, len(out) - begun_at - 4)
                self._joined += 1
            else:
                begun_at = len(out)
                out += packets[at:end]
                struct.pack_into(">H", out, begun_at + 6, number - self._joined & 0xFFFF)
            if not is_fragment or fragment & _IS_LAST:
                begun_at = -1
            follows = (number + 1 & 0xFFFF, ticks, sender, unit)
        return out


# ---- UDP: one port for RTP, the next for RTCP


class RtpPorts:
    """A pair of UDP ports that receive from one host, and send to no other."""

    def __init__(self, control: socket.socket) -> None:
        self.lost = 0  # packets missing by their sequence numbers
        self.has_any = False  # whether one has come
        self._host = control.getpeername()[0]
        self._next: int | None = None
        self._first_ticks = self._last_ticks = 0
        self._torn: deque[int] = deque(maxlen=4096)  # times of pictures that lost something
        self._buffer = bytearray(65_536)
        own = control.getsockname()[0]
        for _ in range(100):  # until two free ports follow each other
            packets = socket.socket(control.family, socket.SOCK_DGRAM)
            reports = socket.socket(control.family, socket.SOCK_DGRAM)
            try:
                packets.bind((own, 0))
                port = packets.getsockname()[1]
                if port % 2 == 0:
                    reports.bind((own, port + 1))
                    break
            except (OSError, OverflowError):
                pass
            packets.close()
            reports.close()
        else:
            raise CameraError("no two UDP ports are free here; try --rtsp-transport tcp")
        packets.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        self.sockets = (packets, reports)
        self.numbers = (port, port + 1)  # the ports; an even one, and the next
        for one in self.sockets:
            one.setblocking(False)

    def open_ways(self, packets_port: int, reports_port: int) -> None:
        """Punch holes through NATs and firewalls with empty packets."""
        # RTP without pictures, and a receiver's report of nothing (RFC 3550).
        nothing = struct.pack(">BBHII", 0x80, 0, 0, 0, 0), struct.pack(">BBHI", 0x80, 201, 1, 0)
        ways = (packets_port, reports_port or packets_port + 1)
        for one, port, data in zip(self.sockets, ways, nothing, strict=True):
            if 0 < port < 65536:
                one.sendto(data, (self._host, port))

    def packets(self) -> Iterator[tuple[int, memoryview]]:
        """Yield (0, RTP packet) or (1, RTCP report); each is valid until the next."""
        for channel, one in enumerate(self.sockets):
            for _ in range(256):  # before anything else is looked after
                try:
                    size, sender = one.recvfrom_into(self._buffer)
                except OSError:  # there is no more; or the host had said that a port is closed
                    break
                if sender[0] == self._host and size >= (12, 8)[channel]:
                    self.has_any = True
                    if channel == 0:
                        self._count(*struct.unpack_from(">HI", self._buffer, 2))
                    yield channel, memoryview(self._buffer)[:size]

    def close(self) -> None:
        """Close the ports."""
        for one in self.sockets:
            one.close()

    def is_torn(self, ticks: int | None) -> bool:
        """Return whether packets were lost, or came late, within or beside a picture."""
        return ticks is not None and (self._first_ticks + ticks & 0xFFFFFFFF) in self._torn

    def _count(self, number: int, ticks: int) -> None:
        if self._next is None:
            self._first_ticks, self._next = ticks, number
        ahead = (number - self._next) & 0xFFFF
        if ahead:  # the end of one picture, the beginning of the next, or all between them
            self._torn += (self._last_ticks, ticks)
        self._last_ticks = ticks
        if ahead < 0x8000:
            self.lost += ahead
            self._next = number + 1 & 0xFFFF
        elif self.lost:  # one that came late
            self.lost -= 1


# ---- RTSP connection: parse replies and interleaved packets

_BUFFER_BYTES = 256 * 1024  # several packets; one has 65,539 at most
_MAX_HEAD_BYTES = 16 * 1024
_DOLLAR = ord("$")  # begins a packet; one byte of channel and two of length follow


@dataclass(frozen=True)
class Reply:
    """A camera's reply."""

    status: int
    reason: str
    headers: tuple[tuple[str, str], ...]  # (name in lower case, value), as often as sent
    body: bytes

    def every(self, name: str) -> list[str]:
        """Return all values of a header that may be repeated."""
        return [value for known, value in self.headers if known == name]

    def header(self, name: str) -> str:
        """Return the value of a header; "" where it was not sent."""
        return next(iter(self.every(name)), "")


class RtspWire:
    """A reader of an RTSP connection."""

    def __init__(self, connected: socket.socket) -> None:
        self.early = bytearray()  # packets that came before an awaited reply
        self._socket = connected
        self._buffer = bytearray(_BUFFER_BYTES)
        self._view = memoryview(self._buffer)
        self._used = self._filled = 0

    def reply(self) -> Reply:
        """Wait for the next reply."""
        while True:
            came = self.take(is_playing=False)
            if isinstance(came, Reply):
                return came
            if came is None:
                if not self.fill():
                    raise CameraAwayError("ends the connection without a reply; check the address")
                continue
            self.early += came
            if len(self.early) > _BUFFER_BYTES:
                raise CameraError("sends packets and no reply; check the address")

    def fill(self) -> int:
        """Read once; return the number of bytes, 0 at the end of the connection."""
        left = self._filled - self._used
        self._view[:left] = self._view[self._used : self._filled]
        self._used = 0
        self._filled = left + (count := self._socket.recv_into(self._view[left:]))
        return count

    def take(self, *, is_playing: bool) -> memoryview | Reply | None:
        """Return a run of whole packets, or a reply; None where more has to come."""
        # Packets are valid until the next `fill`.
        buffer, last = self._buffer, self._filled - 4
        while self._used < self._filled and buffer[self._used] in b"\r\n":
            self._used += 1
        start = at = self._used
        if start == self._filled:
            return None
        if buffer[start] == _DOLLAR:
            while at <= last and buffer[at] == _DOLLAR:
                end = at + 4 + (buffer[at + 2] << 8 | buffer[at + 3])
                if end > self._filled:
                    break
                at = end
            self._used = at
            return self._view[start:at] if at > start else None
        try:
            return self._taken_reply()
        except ValueError as error:
            if not is_playing:
                raise CameraError("does not speak RTSP; check the address") from error
        found = buffer.find(_DOLLAR, start, self._filled)
        self._used = self._filled if found < 0 else found
        return self.take(is_playing=True) if found >= 0 else None

    def _taken_reply(self) -> Reply | None:
        """Parse the reply that begins here; None where it is incomplete."""
        head = bytes(self._view[self._used : self._filled][: _MAX_HEAD_BYTES + 4])
        if not head.startswith(b"RTSP/1."[: len(head)]):
            raise ValueError("no reply")
        if (found := re.search(rb"\r?\n\r?\n", head)) is None:
            if len(head) > _MAX_HEAD_BYTES:
                raise ValueError("a head without an end")
            return None
        status, *lines = head[: found.start()].decode("latin-1").splitlines()
        _, code, reason = (*status.split(" ", 2), "", "")[:3]
        named = (line.partition(":") for line in lines)
        headers = tuple((name.strip().lower(), value.strip()) for name, _, value in named)
        reply = Reply(int(code), reason, headers, b"")
        size = int(reply.header("content-length") or 0)
        if not 0 <= size <= 64 * 1024:  # cameras send a hundredth
            raise ValueError("a body without an end")
        start = self._used + found.end()
        if start + size > self._filled:
            return None
        self._used = start + size
        return replace(reply, body=bytes(self._view[start : self._used]))


# ---- SDP: parse what a session description (RFC 8866) says of its video, and no more

_MEDIA = re.compile(r"m=video \S+ (\S+) (\d{1,3})\b")

# Attributes that say how the video is coded: none of them names a place.
_CODING = re.compile(r"a=(rtpmap|fmtp|framerate|framesize):[\x20-\x7e]{1,4000}")
_CONTROL = re.compile(r"a=control:([\x21-\x7e]{1,1000})\s*")


@dataclass(frozen=True)
class Description:
    """A camera's first video."""

    whole: str  # control URL of the session; "" if there is none
    control: str  # control URL of this video; "" if there is none
    coding: tuple[str, ...]  # the lines that describe its coding

    @classmethod
    def of(cls, text: str) -> Description:
        """Parse a description."""
        session, *media = re.split(r"^(?=m=)", text, flags=re.MULTILINE)
        for section in media:
            if not (found := _MEDIA.match(section)):
                continue
            protocol, kind = found.groups()
            if protocol not in ("RTP/AVP", "RTP/AVPF", "RTP/AVP/TCP", "RTP/AVP/UDP"):
                known = short_name(protocol)
                raise CameraError(f"sends its video by {known}; switch it to RTP/AVP")
            kept = [one[0] for one in map(_CODING.fullmatch, section.splitlines()) if one]
            coding = (f"m=video 0 RTP/AVP {kind}", *kept[:20])
            return cls(_control(session), _control(section), coding)
        raise CameraError("holds no video; give the address of its video")

    @property
    def codec(self) -> str:
        """RTP encoding name, such as "H264"; "" where the payload type implies it."""
        found = (re.match(r"a=rtpmap:\d{1,3}\s+([\w-]+)/", line) for line in self.coding)
        return next((one[1].upper() for one in found if one), "")

    def text(self, control: str) -> str:
        """Format a description of this video alone, under the control name `control`."""
        head = ("v=0", "o=- 0 0 IN IP4 127.0.0.1", "s=-", "c=IN IP4 127.0.0.1", "t=0 0")
        media, *attributes = self.coding
        return "\r\n".join((*head, media, f"a=control:{control}", *attributes, ""))


def _control(section: str) -> str:
    found = (_CONTROL.fullmatch(line) for line in section.splitlines())
    return next((one[1] for one in found if one), "")


# ---- RTSP client: ask the camera, one host, to play its video over TCP, TLS or UDP

_SERVER_PORTS = re.compile(r"\bserver_port\s*=\s*(\d{1,5})(?:-(\d{1,5}))?")
_SESSION = re.compile(r"([\x21-\x3a\x3c-\x7e]{1,200})(?:\s*;\s*timeout\s*=\s*(\d{1,6}))?")
_URL = re.compile(r"rtsps?://[\x21-\x7e]{1,1500}")

_REFRESH_S = (1.0, 30.0)  # shortest and longest time between two keep-alive requests


class RtspClient:
    """A camera that has been asked to play.

    URLs that it names are only words in requests to it: no other host is ever called. Packets are
    taken from its own address alone. Without a transport, TCP is tried, and UDP where the camera
    refuses that; TLS is for TCP alone. `deadline` bounds all until it plays, afterwards each read.
    """

    def __init__(
        self, address: Address, deadline: Deadline, trust: Trust, transport: Transport | None
    ) -> None:
        parts = urlsplit(address.url)
        is_encrypted = parts.scheme == "rtsps"
        port = parts.port or (322 if is_encrypted else 554)
        self.ports: RtpPorts | None = None  # for packets by UDP; None if they are interleaved
        self.channel = 0  # of interleaved RTP; the next one is for RTCP
        self._place = address.url
        self._login = Login.of(address)
        self._session = ""  # its identifier; "" before there is one
        self._count = 0
        self._refresh = "OPTIONS"
        self._refresh_s = _REFRESH_S[1]
        self._next_refresh_s = 0.0
        self.socket = connect(parts.hostname or "", port, deadline, trust if is_encrypted else None)
        self.wire = RtspWire(self.socket)
        with closed_on_failure(self):
            self._play("tcp" if is_encrypted else transport)
        deadline.renew(math.inf)

    def refresh(self) -> float:
        """Send a keep-alive when it is due; return the time until the next [s]."""
        if (left_s := self._next_refresh_s - time.monotonic()) > 0:
            return left_s
        self._send(self._refresh, self._place)
        self._next_refresh_s = time.monotonic() + self._refresh_s
        return self._refresh_s

    def replied(self, reply: Reply) -> None:
        """Handle an unsolicited reply: a 401 renews the login in time."""
        if reply.status == 401:
            with suppress(CameraError):  # the camera will end it
                self._login.take(reply.every("www-authenticate"))
                self._next_refresh_s = time.monotonic() + _REFRESH_S[0]

    def close(self) -> None:
        """Send TEARDOWN and close the connection; safe to call twice."""
        if self._session:
            with suppress(OSError):
                self._send("TEARDOWN", self._place)
        self._session = ""
        self.socket.close()
        if self.ports is not None:
            self.ports.close()

    def _send(self, method: str, place: str, **headers: str) -> None:
        """Send a request without waiting for its reply."""
        self._count += 1
        lines = [f"{method} {place} RTSP/1.0", f"CSeq: {self._count}", "User-Agent: tunenet-record"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        if self._session:
            lines.append(f"Session: {self._session}")
        if proof := self._login.header(method, place):
            lines.append(f"Authorization: {proof}")
        self.socket.sendall("\r\n".join((*lines, "", "")).encode())

    def _ask(self, method: str, place: str, **headers: str) -> Reply:
        """Send a request; return its reply, with status 200, or 461 (Unsupported Transport)."""
        self._send(method, place, **headers)
        reply = self.wire.reply()
        for _ in range(2):  # with the login, and with a fresh nonce
            if reply.status != 401:
                break
            self._login.take(reply.every("www-authenticate"))
            self._send(method, place, **headers)
            reply = self.wire.reply()
        if reply.status == 200 or (reply.status == 461 and method == "SETUP"):
            return reply
        if 300 <= reply.status < 400:
            raise sent_on(reply.header("location"), ("rtsp", "rtsps"))
        raise refused(reply.status, reply.reason, f" to {method}")

    def _play(self, transport: Transport | None) -> None:
        if "GET_PARAMETER" in self._ask("OPTIONS", self._place).header("public").upper():
            self._refresh = "GET_PARAMETER"
        answer = self._ask("DESCRIBE", self._place, Accept="application/sdp")
        self.description = Description.of(answer.body.decode("utf-8", "replace"))
        base = answer.header("content-base") or answer.header("content-location")
        base = base if _URL.fullmatch(base) else self._place
        self._place = _joined(base, self.description.whole)
        video = _joined(base, self.description.control)
        wanted: tuple[Transport, ...] = (transport,) if transport else ("tcp", "udp")
        if not any(self._is_set_up(video, one) for one in wanted):
            refusing = " and ".join(wanted).replace("tcp", "TCP").replace("udp", "UDP")
            raise CameraError(f"refuses {refusing} (461); leave out or change --rtsp-transport")
        self._ask("PLAY", self._place, Range="npt=0.000-")
        self._next_refresh_s = time.monotonic() + self._refresh_s

    def _is_set_up(self, video: str, transport: Transport) -> bool:
        """Send SETUP; return whether the camera accepts the transport."""
        wanted = "/TCP;unicast;interleaved=0-1"
        if transport == "udp":
            self.ports = RtpPorts(self.socket)
            wanted = ";unicast;client_port={}-{}".format(*self.ports.numbers)
        answer = self._ask("SETUP", video, Transport=f"RTP/AVP{wanted}")
        if answer.status != 200:
            return False
        said = answer.header("transport")
        is_tcp = "/TCP" in said.upper()
        if is_tcp is (transport == "udp") or "multicast" in said.lower():
            raise CameraError(
                f"is asked for {transport.upper()} and sets up {short_name(said)}; "
                "try another --rtsp-transport"
            )
        if found := re.search(r"\binterleaved\s*=\s*(\d{1,3})", said):
            self.channel = min(int(found[1]), 254)
        if self.ports and (found := _SERVER_PORTS.search(said)):
            self.ports.open_ways(int(found[1]), int(found[2] or 0))
        if found := _SESSION.match(answer.header("session")):
            self._session = found[1]
            self._refresh_s = min(max(int(found[2] or 60) / 2, _REFRESH_S[0]), _REFRESH_S[1])
        return True


def _joined(base: str, control: str) -> str:
    """Join a base URL and a control attribute as cameras mean it, against RFC 3986."""
    if _URL.fullmatch(control):
        return control
    if control in ("", "*"):
        return base
    return f"{base}{'' if base.endswith('/') else '/'}{control}"


# ---- Relay: serve the camera's packets to FFmpeg on this machine alone


class RtspRelay:
    """A loopback RTSP server for one reader."""

    def __init__(self, client: RtspClient, silence_s: float) -> None:
        self._ended = ""
        self._client = client  # the camera, playing; it is closed here
        self._joiner = FragmentJoiner(client.description.codec, client.channel)
        self._silence_s = silence_s  # the longest time without a packet
        self._is_closed = False
        self._path = secrets.token_hex(8)  # others on this machine may call, but do not know it
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(10.0)  # [s]; FFmpeg is asked to connect at once
        self._reader: socket.socket | None = None
        self._thread = threading.Thread(target=self._run, name="rtsp relay", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """URL of the relayed video."""
        return f"rtsp://127.0.0.1:{self._listener.getsockname()[1]}/{self._path}"

    @property
    def lost(self) -> int:
        """Number of lost packets; 0 over TCP."""
        return self._client.ports.lost if self._client.ports else 0

    def is_torn(self, ticks: int | None) -> bool:
        """Return whether packets were lost in or beside a picture, or its end never came."""
        ports = self._client.ports
        return self._joiner.is_open(ticks) or (ports is not None and ports.is_torn(ticks))

    def close(self) -> None:
        """Stop relaying, from any thread, and close the camera."""
        self._is_closed = True
        for one in (self._client.socket, self._listener, self._reader):
            if one is not None:
                with suppress(OSError):  # it is closed already
                    socket.socket.shutdown(one, socket.SHUT_RD)
        if self._reader is not None:
            with suppress(OSError):
                self._reader.shutdown(socket.SHUT_RDWR)

    def ended_by(self) -> str:
        """Stop relaying; return why it had ended, "" where it was still running."""
        is_asked = self._is_closed
        self._thread.join(0.2)  # [s]; what ends by itself says why
        was_running = self._thread.is_alive()
        self.close()
        return "" if is_asked or was_running else self._ended

    def _run(self) -> None:
        try:
            with self._listener:
                self._reader, _ = self._listener.accept()
            with self._reader as reader:
                reader.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                try:
                    self._greet(reader)
                    self._ended = self._pass_on(reader)
                except TimeoutError:
                    ports = self._client.ports
                    hint = " over UDP; if a firewall is between, try --rtsp-transport tcp"
                    said = hint if ports and not ports.has_any else ""
                    self._ended = f"no data for {self._silence_s:.1f} s{said}"
                except OSError as error:
                    why = error.strerror or type(error).__name__
                    self._ended = f"the connection to the camera broke ({why})"
                self._client.close()
                reader.shutdown(socket.SHUT_WR)
                while reader.recv(65536):  # closed before it is read out, it would lose packets
                    pass
        except OSError:
            pass  # nobody reads any more
        finally:
            self._client.close()

    def _greet(self, reader: socket.socket) -> None:
        """Answer FFmpeg's requests up to PLAY."""
        description = self._client.description.text("video")
        channel = self._client.channel
        answers = {
            "OPTIONS": "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n\r\n",
            "DESCRIBE": "Content-Type: application/sdp\r\n"
            f"Content-Length: {len(description)}\r\n\r\n{description}",
            "SETUP": f"Transport: RTP/AVP/TCP;unicast;interleaved={channel}-{channel + 1}\r\n\r\n",
            "PLAY": "\r\n",
        }
        method, said = "", bytearray()
        while method != "PLAY":
            while (end := said.find(b"\r\n\r\n")) < 0:
                if len(said) > 16 * 1024 or not (more := reader.recv(4096)):
                    raise ConnectionError("nobody reads")
                said += more
            request, *lines = said[:end].decode("latin-1").split("\r\n")
            del said[: end + 4]
            method, place = (*request.split(" "), "")[:2]
            number = next(line for line in lines if line.lower().startswith("cseq"))
            if self._path not in place or method not in answers:
                raise ConnectionError("a stranger reads")
            head = f"RTSP/1.0 200 OK\r\n{number}\r\nSession: 1\r\n"
            reader.sendall((head + answers[method]).encode())

    def _pass_on(self, reader: socket.socket) -> str:
        """Relay packets until one side ends; return why, "" where FFmpeg hung up."""
        client, wire = self._client, self._client.wire
        udp = client.ports.sockets if client.ports else ()
        reader.sendall(self._joiner.joined(memoryview(wire.early)))
        passed_s = time.monotonic()
        while not self._is_closed:
            for packets in self._come():
                reader.sendall(self._joiner.joined(packets))
                passed_s = time.monotonic()
            left_s = passed_s + self._silence_s - time.monotonic()
            wait_s = min(client.refresh(), left_s, 1.0)
            if wait_s <= 0:
                raise TimeoutError
            ready, _, _ = select.select([client.socket, reader, *udp], [], [], wait_s)
            if reader in ready and not reader.recv(65536):  # its reports are not passed on
                return ""
            if client.socket in ready:
                if not udp:
                    # TCP keeps what comes meanwhile: the pieces of a picture are passed on
                    # together, the first of them at once, as its time of arrival wants it.
                    time.sleep(max(0.0, passed_s + 0.003 - time.monotonic()))
                if not wire.fill():
                    return "the stream was closed by the camera"
        return ""

    def _come(self) -> Iterator[memoryview]:
        """Yield the received packets, interleaved."""
        while (came := self._client.wire.take(is_playing=True)) is not None:
            if isinstance(came, Reply):
                self._client.replied(came)
            else:
                yield came
        if self._client.ports is None:
            return
        beside = bytearray()
        for channel, packet in self._client.ports.packets():
            beside += struct.pack(">cBH", b"$", channel, len(packet))
            beside += packet
        if beside:
            yield memoryview(beside)


# ---- Stream: the relayed video, read by FFmpeg

_OPTIONS = {
    "rtsp_transport": "tcp",  # to the relay; the camera's may differ
    "protocol_whitelist": "tcp",
    "probesize": "32",  # the description says what comes; a second of pictures would say no more
    **NOT_PARSED,
}


class RtspStream(PacketStream):
    """An RTSP stream."""

    def __init__(
        self, address: Address, timeout_s: float, trust: Trust, transport: Transport | None
    ) -> None:
        import av
        from av import logging
        from av.error import FFmpegError

        logging.set_level(None)  # errors come as exceptions
        deadline = Deadline.opening()
        with answering(address.shown, deadline):
            client = RtspClient(address, deadline, trust, transport)
        deadline.silence_s = timeout_s
        # None falls back to UDP where the camera refuses TCP.
        self._transport = "udp" if client.ports else "tcp"
        self._relay = RtspRelay(client, timeout_s)
        with closed_on_failure(self._relay):
            try:
                # It waits 2 s longer than the relay, which can say why nothing comes.
                container = av.open(
                    self._relay.url, "r", format="rtsp", options=_OPTIONS, timeout=timeout_s + 2.0
                )
            except FFmpegError as error:
                why = self._relay.ended_by() or error.strerror
                raise CameraAwayError(f"{address.shown}: gives no video ({why})") from error
            super().__init__(container, address.shown, timeout_s, is_damaged=self._relay.is_torn)

    def notes(self) -> dict[str, str]:
        """Return the codec, the transport, and the number of lost packets."""
        lost = {"lost_packets": str(self._relay.lost)} if self._relay.lost else {}
        return super().notes() | {"transport": self._transport} | lost

    def close(self) -> None:
        """End a running `frames`; the camera is told to stop."""
        super().close()
        self._relay.close()

    def _release(self) -> None:
        super()._release()
        self.ended = self._relay.ended_by() or self.ended
