"""Join fragmented NAL units of RTP into fewer and larger packets.

Each costs FFmpeg six calls of the kernel and us a Python object; a 4K picture comes in fifty.
"""

from __future__ import annotations

import struct

# An interleaved packet: "$", channel, length; and of RTP (RFC 3550) its first byte, marker and
# kind, number, time and sender.
_PACKET = struct.Struct(">BBHBBHII")

_PLAIN = 0x80  # RTP's first byte, where nothing stands between its head and its payload
_MARKER = 0x80
_IS_FIRST, _IS_LAST = 0x80, 0x40  # of a fragment, in the byte that says so
_MAX_BYTES = 60_000  # of a packet that is put together; what it has in all is stated in two bytes
# Bytes before a fragment's data: of a NAL unit (RFC 6184, 7798), and the one that says which.
_HEADS = {"H264": 2, "H265": 3}

# Where the first byte of a payload says what it is, and what it says of a fragment.
_KINDS = {"H264": (0x1F, 28), "H265": (0x7E, 49 << 1)}


class FragmentJoiner:
    """Joins consecutive fragments (FU) of one NAL unit (RFC 6184, 7798).

    Packets are renumbered, so that a sequence number is missing where a packet is, and nowhere
    else. Unknown packets are passed on as they came.

    Args:
        coding: "H264" or "H265"; packets of any other are passed on as they came.
        channel: on which the pictures come.
    """

    def __init__(self, coding: str, channel: int) -> None:
        self._head_bytes = _HEADS.get(coding, 0)
        self._mask, self._kind = _KINDS.get(coding, (0, 0))
        self._channel = channel
        self._joined = 0
        self._first_ticks: int | None = None
        self._last_ticks = 0
        self._is_whole = True

    def is_open(self, ticks: int | None) -> bool:
        """Return whether the picture at `ticks` (first: 0) is the last, its end missing.

        Args:
            ticks: its time, from 0 for the first.
        """
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
            self._last_ticks, self._is_whole = ticks, bool(kind & _MARKER)
            head = bytes(packets[at + payload : at + data_at])
            fragment = head[-1]
            is_fragment = plain == _PLAIN and head[0] & self._mask == self._kind
            unit = head[:-1] + bytes((fragment & 0x3F,))
            if (
                is_fragment
                and begun_at >= 0
                and follows == (number, ticks, sender, unit)
                and not fragment & _IS_FIRST
                and len(out) - begun_at + end - at < _MAX_BYTES
            ):
                out += packets[at + data_at : end]
                out[begun_at + 5] |= kind & _MARKER
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
