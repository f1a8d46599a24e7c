"""The pictures of one topic, one at a time, as frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from tunenet_logs.episode import Frame
from tunenet_logs.formats.base import DAMAGED, RawChannel, RawMessage, Record
from tunenet_logs.formats.codec import Decode, MessageError, UnusableError
from tunenet_logs.formats.codecs import decoder_for
from tunenet_logs.formats.kinds import Picture, Pictures, kind_of


def frames_of(records: Iterable[Record], topic: str, *, is_told: bool) -> Iterator[Frame]:
    """The frames among the records of a log, in its order.

    Args:
        records: of the log, perhaps of that topic alone.
        topic: where the pictures are.
        is_told: whether their header stamps tell the time, where they are set; else the log's do.
    """
    decoders: dict[RawChannel, tuple[Decode, Pictures]] = {}
    for record in records:
        if isinstance(record, RawChannel) and record.topic == topic:
            kind = kind_of(record)
            if isinstance(kind, Pictures):
                try:
                    decoders[record] = (decoder_for(record), kind)
                except UnusableError:
                    continue
        elif isinstance(record, RawMessage) and record.channel in decoders:
            decode, kind = decoders[record.channel]
            try:
                picture = kind.read(decode(record.data))
            except (MessageError, *DAMAGED):
                continue
            stamp_ns = picture.stamp_ns if is_told and picture.stamp_ns else record.log_ns
            yield _frame(stamp_ns, picture)


def _frame(stamp_ns: int, picture: Picture) -> Frame:
    return Frame(stamp_ns, picture.encoding, bytes(picture.data))
