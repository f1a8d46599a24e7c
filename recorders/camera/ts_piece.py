"""A piece of MPEG-TS behind another: that its packets are counted anew is no loss (ISO 13818-1)."""

from __future__ import annotations

from recorders.camera.timed_feed import ByteFeed

_PACKET_BYTES, _SYNC = 188, 0x47
_NO_PAYLOAD, _DISCONTINUITY = 0x20, 0x80
_READ_BYTES = 65536


class TsPiece:
    """A piece, in which a mark stands before each stream's first packet: its count may leap here.

    Without the mark a leap is a loss, and the picture before it damaged. What is no MPEG-TS stays
    as it is.

    Args:
        feed: the piece; closed with this.
    """

    def __init__(self, feed: ByteFeed) -> None:
        self._feed = feed
        self._rest = b""
        self._ready = bytearray()
        self._marked: set[int] = set()
        self._is_ts = True

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        while not self._ready:
            data = self._feed.read(_READ_BYTES)
            if not data:
                self._ready += self._rest
                self._rest = b""
                break
            self._take(self._rest + data)
        data = bytes(self._ready[:most])
        del self._ready[:most]
        return data

    def close(self) -> None:
        """See `ByteFeed`."""
        self._feed.close()

    def _take(self, data: bytes) -> None:
        at = 0
        while self._is_ts and at + _PACKET_BYTES <= len(data):
            packet = data[at : at + _PACKET_BYTES]
            self._is_ts = packet[0] == _SYNC
            stream = (packet[1] & 0x1F) << 8 | packet[2]
            if self._is_ts and stream not in self._marked:
                self._marked.add(stream)
                self._ready += _mark(stream, packet[3] & 0x0F)
            self._ready += packet
            at += _PACKET_BYTES
        if not self._is_ts:
            self._ready += data[at:]
            at = len(data)
        self._rest = data[at:]


def _mark(stream: int, count: int) -> bytes:
    """A packet without payload; it says that the stream's next packet may have any count.

    Args:
        stream: its number (PID).
        count: of the next packet, with payload.
    """
    header = bytes((_SYNC, stream >> 8, stream & 0xFF, _NO_PAYLOAD | (count - 1) & 0x0F))
    fields = bytes((_PACKET_BYTES - len(header) - 1, _DISCONTINUITY))
    return (header + fields).ljust(_PACKET_BYTES, b"\xff")
