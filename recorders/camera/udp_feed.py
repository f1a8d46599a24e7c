"""Receive video in datagrams (MPEG-TS over UDP), unicast or multicast."""

from __future__ import annotations

import errno
import ipaddress
import re
import select
import socket
import struct

from recorders.closing import closed_on_failure
from recorders.deadline import Deadline
from tunenet_logs.errors import CameraError, UsageError

_PLACE = re.compile(r"udp://@?(\[[0-9a-f:.]+\]|[a-z0-9.-]*):(\d{1,5})/?", re.IGNORECASE)
_MAX_BYTES = 65536
# Asked of the kernel for datagrams that wait: a key picture comes as hundreds of them at once.
_KERNEL_BYTES = 4 * 1024 * 1024

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
        found = _PLACE.fullmatch(text)
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
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _KERNEL_BYTES)
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
            data, (sender, *_) = self._socket.recvfrom(_MAX_BYTES)
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
