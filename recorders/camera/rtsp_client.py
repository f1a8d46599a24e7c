"""Ask an RTSP camera to play its video (RFC 2326): one host, over TCP, TLS or UDP."""

from __future__ import annotations

import math
import re
import time
from contextlib import suppress
from urllib.parse import urlsplit

from recorders.camera.connection import connect
from recorders.camera.login import Login
from recorders.camera.network_options import Transport
from recorders.camera.rtp_ports import RtpPorts
from recorders.camera.rtsp_requests import UNSUPPORTED_TRANSPORT, RtspRequests
from recorders.camera.rtsp_wire import Reply
from recorders.camera.sdp import Description
from recorders.camera.tls import Trust
from recorders.closing import closed_on_failure
from recorders.deadline import Deadline
from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraError
from tunenet_logs.terminal import short_name

_PORTS = {"rtsp": 554, "rtsps": 322}  # that are meant where an address names none
_CHANNELS = re.compile(r"\binterleaved\s*=\s*(\d{1,3})")
_SERVER_PORTS = re.compile(r"\bserver_port\s*=\s*(\d{1,5})(?:-(\d{1,5}))?")
_SESSION = re.compile(r"([\x21-\x3a\x3c-\x7e]{1,200})(?:\s*;\s*timeout\s*=\s*(\d{1,6}))?")
_PLACE = re.compile(r"rtsps?://[\x21-\x7e]{1,1500}")

# The shortest and the longest time between two requests that keep a session alive.
_REFRESH_S = (1.0, 30.0)


class RtspClient:
    """A camera that has been asked to play.

    URLs that it names are only words in requests to it: no other host is ever called. Packets are
    taken from its own address alone.

    Args:
        deadline: until it plays; afterwards for each read.
        trust: which certificates are trusted.
        transport: None tries TCP, and UDP where the camera refuses that; TLS is for TCP alone.

    Attributes:
        socket: the control connection.
        wire: its reader.
        ports: UDP ports for the packets; None if they are interleaved.
        channel: of interleaved RTP; the next one is for RTCP.
        description: of its video.

    Raises:
        CameraError: it cannot be reached, refuses, or has no video.
    """

    def __init__(
        self, address: Address, deadline: Deadline, trust: Trust, transport: Transport | None
    ) -> None:
        parts = urlsplit(address.url)
        is_encrypted = parts.scheme == "rtsps"
        port = parts.port or _PORTS[parts.scheme]
        login = Login.of(address)
        self.ports: RtpPorts | None = None
        self.channel = 0
        self._place = address.url
        self._refresh = "OPTIONS"
        self._refresh_s = _REFRESH_S[1]
        self._next_refresh_s = 0.0
        self.socket = connect(parts.hostname or "", port, deadline, trust if is_encrypted else None)
        self._requests = RtspRequests(self.socket, login)
        self.wire = self._requests.wire
        with closed_on_failure(self):
            self._play(Transport.TCP if is_encrypted else transport)
        deadline.renew(math.inf)

    def refresh(self) -> float:
        """Send a keep-alive when it is due; return the time until the next [s]."""
        if (left_s := self._next_refresh_s - time.monotonic()) > 0:
            return left_s
        self._requests.send(self._refresh, self._place)
        self._next_refresh_s = time.monotonic() + self._refresh_s
        return self._refresh_s

    def replied(self, reply: Reply) -> None:
        """Handle an unsolicited reply: a 401 renews the login in time."""
        if reply.status == 401:
            with suppress(CameraError):  # the camera will end it
                self._requests.log_in(reply)
                self._next_refresh_s = time.monotonic() + _REFRESH_S[0]

    def close(self) -> None:
        """Send TEARDOWN and close the connection; safe to call twice."""
        if self._requests.session:
            with suppress(OSError):
                self._requests.send("TEARDOWN", self._place)
        self._requests.session = ""
        self.socket.close()
        if self.ports is not None:
            self.ports.close()

    def _play(self, transport: Transport | None) -> None:
        ask = self._requests.ask
        if "GET_PARAMETER" in ask("OPTIONS", self._place).header("public").upper():
            self._refresh = "GET_PARAMETER"
        answer = ask("DESCRIBE", self._place, {"Accept": "application/sdp"})
        self.description = Description.of(answer.body.decode("utf-8", "replace"))
        base = answer.header("content-base") or answer.header("content-location")
        base = base if _PLACE.fullmatch(base) else self._place
        self._place = _joined(base, self.description.whole)
        video = _joined(base, self.description.control)
        wanted = (transport,) if transport else (Transport.TCP, Transport.UDP)
        if not any(self._is_set_up(video, one) for one in wanted):
            refused = " and ".join(one.name for one in wanted)
            raise CameraError(f"refuses {refused} (461); leave out or change --rtsp-transport")
        ask("PLAY", self._place, {"Range": "npt=0.000-"})
        self._next_refresh_s = time.monotonic() + self._refresh_s

    def _is_set_up(self, video: str, transport: Transport) -> bool:
        """Send SETUP; return whether the camera accepts the transport.

        Raises:
            CameraError: it answers with another transport.
        """
        wanted = "/TCP;unicast;interleaved=0-1"
        if transport is Transport.UDP:
            self.ports = RtpPorts(self.socket)
            wanted = ";unicast;client_port={}-{}".format(*self.ports.numbers)
        answer = self._requests.ask(
            "SETUP", video, {"Transport": f"RTP/AVP{wanted}"}, UNSUPPORTED_TRANSPORT
        )
        if answer.status == UNSUPPORTED_TRANSPORT:
            return False
        said = answer.header("transport")
        is_tcp = "/TCP" in said.upper()
        if is_tcp is (transport is Transport.UDP) or "multicast" in said.lower():
            raise CameraError(
                f"is asked for {transport.name} and sets up {short_name(said)}; "
                "try another --rtsp-transport"
            )
        if found := _CHANNELS.search(said):
            self.channel = min(int(found[1]), 254)
        if self.ports and (found := _SERVER_PORTS.search(said)):
            self.ports.open_ways(int(found[1]), int(found[2] or 0))
        if found := _SESSION.match(answer.header("session")):
            self._requests.session = found[1]
            shortest_s, longest_s = _REFRESH_S
            self._refresh_s = min(max(int(found[2] or 60) / 2, shortest_s), longest_s)
        return True


def _joined(base: str, control: str) -> str:
    """Join a base URL and a control attribute as cameras mean it, against RFC 3986."""
    if _PLACE.fullmatch(control):
        return control
    if control in ("", "*"):
        return base
    return f"{base}{'' if base.endswith('/') else '/'}{control}"
