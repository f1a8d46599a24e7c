"""Packets of a container as whole pictures, each with its time and the moment when it came."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from av import Packet

_MOST_BYTES = 64 * 1024 * 1024
"""Of one picture; a JPEG of 36 megapixels has 30. What has more never ends."""


class Unit(NamedTuple):
    """One compressed picture.

    Attributes:
        data: its bytes.
        ticks: its time, in the stream's own units; None where nothing tells.
        arrived_ns: when its first byte came, on the clock that was asked.
        is_key: whether the container says that it stands alone.
        is_corrupt: whether FFmpeg knows that something of it is missing.
    """

    data: bytes
    ticks: int | None
    arrived_ns: int
    is_key: bool
    is_corrupt: bool


def whole_units(
    packets: Iterable[Packet], arrived_ns: Callable[[Packet], int], *, is_cut: bool
) -> Iterator[Unit]:
    """One unit for each packet that holds anything.

    Args:
        packets: as FFmpeg's own parser hands them over.
        arrived_ns: when a packet's first byte was here.
        is_cut: whether the parser has to find where a picture ends: it does in the next one, and
            what is known to be missing of that it then says of the picture before.
    """
    is_next_corrupt = False
    for packet in packets:
        if packet.size:
            came_ns = arrived_ns(packet)
            is_corrupt = is_next_corrupt if is_cut else packet.is_corrupt
            is_next_corrupt = packet.is_corrupt
            yield Unit(bytes(packet), packet.pts, came_ns, packet.is_keyframe, is_corrupt)


def joined_units(packets: Iterable[Packet], arrived_ns: Callable[[Packet], int]) -> Iterator[Unit]:
    """One unit for all packets in a row that have one time, which in RTP is one picture's.

    FFmpeg's parser, which would join them too, forgets the time of the first picture, and hands
    over each so late that its arrival is the next one's.

    Args:
        packets: as they came, not parsed.
        arrived_ns: when a packet's first byte was here.
    """
    pieces: list[bytes] = []
    size = 0
    ticks: int | None = None
    came_ns = 0
    is_key = is_corrupt = False
    for packet in packets:
        if not packet.size:
            continue
        is_next = packet.pts is not None and packet.pts != ticks
        if pieces and (is_next or size > _MOST_BYTES):
            yield Unit(b"".join(pieces), ticks, came_ns, is_key, is_corrupt)
            pieces, size, is_key, is_corrupt = [], 0, False, False
        if not pieces:
            came_ns, ticks = arrived_ns(packet), packet.pts
        pieces.append(bytes(packet))
        size += packet.size
        is_key = is_key or packet.is_keyframe
        is_corrupt = is_corrupt or packet.is_corrupt
    if pieces:
        yield Unit(b"".join(pieces), ticks, came_ns, is_key, is_corrupt)
