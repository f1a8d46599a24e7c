"""Access units: a container's packets as whole pictures, with timestamp and arrival time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from av import Packet

# Of one picture; a JPEG of 36 megapixels has 30. What has more never ends.
_MAX_BYTES = 64 * 1024 * 1024


class Unit(NamedTuple):
    """One compressed picture (access unit).

    Attributes:
        ticks: presentation timestamp in the stream's time base; None where the stream has none.
        arrived_ns: when its first byte arrived [ns].
        is_key: whether the container marks it as a key frame.
        is_corrupt: whether FFmpeg reports data missing from it.
    """

    data: bytes
    ticks: int | None
    arrived_ns: int
    is_key: bool
    is_corrupt: bool


def whole_units(
    packets: Iterable[Packet], arrived_ns: Callable[[Packet], int], *, is_cut: bool
) -> Iterator[Unit]:
    """Yield one unit per non-empty packet of a parsed stream.

    Args:
        packets: as FFmpeg's parser returns them.
        arrived_ns: when a packet's first byte arrived [ns].
        is_cut: whether the parser searches for a picture's end: it finds it in the next one, and
            reports data missing from that one on the picture before.
    """
    is_next_corrupt = False
    for packet in packets:
        if packet.size:
            came_ns = arrived_ns(packet)
            is_corrupt = is_next_corrupt if is_cut else packet.is_corrupt
            is_next_corrupt = packet.is_corrupt
            yield Unit(bytes(packet), packet.pts, came_ns, packet.is_keyframe, is_corrupt)


def joined_units(packets: Iterable[Packet], arrived_ns: Callable[[Packet], int]) -> Iterator[Unit]:
    """Yield one unit per run of packets with one timestamp, which in RTP is one picture.

    FFmpeg's parser, which would join them too, loses the time of the first picture, and returns
    each so late that its arrival is the next one's.

    Args:
        packets: as they came, not parsed.
        arrived_ns: when a packet's first byte arrived [ns].
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
        if pieces and (is_next or size > _MAX_BYTES):
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
