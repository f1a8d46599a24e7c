"""The pictures of one topic, one at a time, as frames; what they claim is checked first."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import DAMAGED, RawChannel, RawMessage, Record
from tunenet_logs.formats.codec import Decode, MessageError, UnusableError
from tunenet_logs.formats.codecs import decoder_for
from tunenet_logs.formats.kinds import Kind, Picture, Pictures, kind_of
from tunenet_logs.formats.video_messages import CODECS, Packet, decoded
from tunenet_logs.images import MAX_PIXELS, image_format
from tunenet_logs.pixels import Layout, layout_of


def frames_of(records: Iterable[Record], topic: str, *, is_told: bool) -> Iterator[Frame]:
    """The frames among the records of a log, in its order; those that cannot be used are left out.

    Args:
        records: of the log, perhaps of that topic alone.
        topic: where the pictures are.
        is_told: whether their header stamps tell the time, where they are set; else the log's do.
    """
    found = _found_in(records, topic, is_told=is_told)
    for is_video, group in groupby(found, key=lambda one: one.is_video):
        if is_video:
            yield from decoded(
                Packet(one.stamp_ns, one.picture.encoding, bytes(one.picture.data)) for one in group
            )
        else:
            yield from (_frame(one.stamp_ns, one.picture) for one in group)


def checked(kind: Kind) -> Callable[[Any], Any]:
    """How messages of a kind are read, pictures only where a frame can be made of them.

    What is returned raises:
        UnusableError: pictures of that encoding are not read.
        MessageError, or one of DAMAGED: the message is.
    """
    if not isinstance(kind, Pictures):
        return kind.read
    read = kind.read
    check = _check_video if kind.is_video else _check_picture

    def read_checked(message: Any) -> Picture:
        picture = read(message)
        check(picture)
        memoryview(picture.data)  # raises TypeError, as what is damaged does
        return picture

    return read_checked


@dataclass(slots=True)
class _Found:
    stamp_ns: int
    picture: Picture
    is_video: bool


def _found_in(records: Iterable[Record], topic: str, *, is_told: bool) -> Iterator[_Found]:
    readers: dict[RawChannel, tuple[Decode, Callable[[Any], Picture], bool]] = {}
    for record in records:
        if isinstance(record, RawChannel) and record.topic == topic:
            kind = kind_of(record)
            if isinstance(kind, Pictures):
                try:
                    readers[record] = (decoder_for(record), checked(kind), kind.is_video)
                except UnusableError:
                    continue
        elif isinstance(record, RawMessage) and record.channel in readers:
            decode, read, is_video = readers[record.channel]
            try:
                picture = read(decode(record.data))
            except (MessageError, UnusableError, *DAMAGED):
                continue
            stamp_ns = picture.stamp_ns if is_told and picture.stamp_ns else record.log_ns
            yield _Found(stamp_ns, picture, is_video)


def _check_video(picture: Picture) -> None:
    if picture.encoding not in CODECS:
        known = ", ".join(CODECS)
        raise UnusableError(f"video of format {picture.encoding[:24]!r} is not read (only {known})")


def _check_picture(picture: Picture) -> None:
    if picture.size is not None:
        _check_pixels(picture, picture.size)
    elif "compressedDepth" in picture.encoding:
        raise UnusableError("compressedDepth pictures are distances, not what a camera sees")


def _check_pixels(picture: Picture, size: tuple[int, int]) -> None:
    """Whether there are as many bytes as size and step claim."""
    try:
        layout = layout_of(picture.encoding)
    except LogError as error:
        raise UnusableError(str(error)) from error
    width, height = size
    if width <= 0 or height <= 0 or width % layout.shares[0] or height % layout.shares[1]:
        raise MessageError(f"no {picture.encoding} picture is of {width} x {height} px")
    if width * height > MAX_PIXELS:
        raise MessageError(f"a picture claims {width} x {height} px")
    step, rows = _step(picture, width, layout), layout.rows(height)
    if step < layout.row_bytes(width):
        raise MessageError(f"a picture has rows of {width} px in {step} bytes")
    if memoryview(picture.data).nbytes < step * rows:
        raise MessageError(f"a picture has {len(picture.data)} bytes for {rows} rows of {step}")


def _step(picture: Picture, width: int, layout: Layout) -> int:
    return picture.step or layout.row_bytes(width)


def _frame(stamp_ns: int, picture: Picture) -> Frame:
    """A picture that was checked."""
    if picture.size is None:
        data = bytes(picture.data)
        # Senders write "jpeg", "jpg", "rgb8; jpeg compressed bgr8", or what it is not.
        return Frame(stamp_ns, image_format(data) or picture.encoding, data)
    layout = layout_of(picture.encoding)
    width, height = picture.size
    step, row, rows = _step(picture, width, layout), layout.row_bytes(width), layout.rows(height)
    pixels = np.frombuffer(picture.data, np.uint8, step * rows).reshape(rows, step)[:, :row]
    if picture.is_bigendian and layout.sample_bytes == 2:
        pixels = np.ascontiguousarray(pixels).view(">u2").astype("<u2")
    return Frame(stamp_ns, picture.encoding, pixels.tobytes(), picture.size)
