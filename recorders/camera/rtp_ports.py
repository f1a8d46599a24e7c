"""Receive a camera's packets on two UDP ports: RTP and RTCP."""

from __future__ import annotations

import socket
import struct
from collections import deque
from collections.abc import Iterator

from tunenet_logs.errors import CameraError

# Asked of the kernel, which gives what it allows: a large key picture comes all at once.
_RECEIVE_BYTES = 8 * 1024 * 1024

_MAX_TRIES = 100  # for two free ports that follow each other
_PACKET_BYTES = 65_536
_MAX_AT_ONCE = 256  # packets that are taken before anything else is looked after
_MAX_TORN = 4096  # times of pictures of which something was lost, until they are asked for
_EMPTY_PACKET = struct.pack(">BBHII", 0x80, 0, 0, 0, 0)
# RTP without pictures, and a receiver's report of nothing (RFC 3550): they open a router's way.
_EMPTY_REPORT = struct.pack(">BBHI", 0x80, 201, 1, 0)

_NUMBER_AND_TICKS = struct.Struct(">HI")  # of an RTP packet, behind its first two bytes


class RtpPorts:
    """A pair of UDP ports that receive from one host, and send to no other.

    Args:
        control: the connection to that host.

    Attributes:
        numbers: the ports; an even one, and the next.
        lost: packets missing by their sequence numbers.
        has_any: whether one has come.

    Raises:
        CameraError: there are no free ports.
    """

    def __init__(self, control: socket.socket) -> None:
        self.lost = 0
        self.has_any = False
        self._host = control.getpeername()[0]
        self._next: int | None = None
        self._first_ticks = self._last_ticks = 0
        self._torn: deque[int] = deque(maxlen=_MAX_TORN)
        self._buffer = bytearray(_PACKET_BYTES)
        own = control.getsockname()[0]
        for _ in range(_MAX_TRIES):
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
        packets.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        self.sockets = (packets, reports)
        self.numbers = (port, port + 1)
        for one in self.sockets:
            one.setblocking(False)

    def open_ways(self, packets_port: int, reports_port: int) -> None:
        """Punch holes through NATs and firewalls with empty packets."""
        ways = ((packets_port, _EMPTY_PACKET), (reports_port or packets_port + 1, _EMPTY_REPORT))
        for one, (port, nothing) in zip(self.sockets, ways, strict=True):
            if 0 < port < 65536:
                one.sendto(nothing, (self._host, port))

    def packets(self) -> Iterator[tuple[int, memoryview]]:
        """Yield (0, RTP packet) or (1, RTCP report); each is valid until the next."""
        for channel, one in enumerate(self.sockets):
            for _ in range(_MAX_AT_ONCE):
                try:
                    size, sender = one.recvfrom_into(self._buffer)
                except OSError:  # there is no more; or the host had said that a port is closed
                    break
                if sender[0] == self._host and size >= (12, 8)[channel]:
                    self.has_any = True
                    if channel == 0:
                        self._count(*_NUMBER_AND_TICKS.unpack_from(self._buffer, 2))
                    yield channel, memoryview(self._buffer)[:size]

    def close(self) -> None:
        """Close the ports."""
        for one in self.sockets:
            one.close()

    def is_torn(self, ticks: int | None) -> bool:
        """Return whether packets were lost, or came late, within or beside a picture.

        Args:
            ticks: its time, from 0 for the first.
        """
        if ticks is None:
            return False
        sent_ticks = self._first_ticks + ticks & 0xFFFFFFFF
        return sent_ticks in self._torn

    def _count(self, number: int, ticks: int) -> None:
        if self._next is None:
            self._first_ticks = ticks
        ahead = 0 if self._next is None else (number - self._next) & 0xFFFF
        if ahead:  # the end of one picture, the beginning of the next, or all between them
            self._torn += (self._last_ticks, ticks)
        self._last_ticks = ticks
        if ahead < 0x8000:
            self.lost += ahead
            self._next = number + 1 & 0xFFFF
        elif self.lost:  # one that came late
            self.lost -= 1
