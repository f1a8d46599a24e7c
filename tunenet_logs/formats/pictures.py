"""Read the images of one topic as frames, one at a time; their claimed sizes are checked first."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from heapq import heappop, heappush
from itertools import groupby
from typing import Any

import numpy as np

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.formats.any_messages import SchemaBudget
from tunenet_logs.formats.base import (
    DAMAGED,
    Decode,
    MessageError,
    RawChannel,
    RawMessage,
    Record,
    UnusableError,
    one_by_one,
)
from tunenet_logs.formats.decoders import Decoders
from tunenet_logs.formats.message_types import PictureSample, PictureType, message_type_of
from tunenet_logs.formats.video_messages import CODECS, Packet, decoded
from tunenet_logs.images import MAX_PIXELS, image_format
from tunenet_logs.pixels import PixelFormat, pixel_format_of


def in_order(frames: Iterable[Frame], ahead: int) -> Iterator[Frame]:
    """Sort frames by stamp with a bounded heap; each lies at most `ahead` places from its own."""
    waiting: list[tuple[int, int, Frame]] = []
    for number, frame in enumerate(frames):
        heappush(waiting, (frame.stamp_ns, number, frame))
        if len(waiting) > ahead:
            yield heappop(waiting)[2]
    while waiting:
        yield heappop(waiting)[2]


def frames_of(records: Iterable[Record], topic: str, *, trusts_header: bool) -> Iterator[Frame]:
    """Yield the frames of a topic in log order, leaving out unusable ones.

    Args:
        records: of the log, perhaps of that topic alone.
        topic: of the images.
        trusts_header: whether to use header stamps, where they are set; else the log's.
    """
    found = _found_in(records, topic, trusts_header=trusts_header)
    for is_video, group in groupby(found, key=lambda each: each[0]):
        if is_video:
            yield from decoded(
                Packet(stamp_ns, picture.encoding, bytes(picture.data))
                for _, stamp_ns, picture in group
            )
        else:
            yield from (_frame(stamp_ns, picture) for _, stamp_ns, picture in group)


def checked_pictures(pictures: PictureType) -> Callable[[Any], PictureSample]:
    """Return a reader of a type's images that validates each of them.

    The reader raises:
        UnusableError: images of that encoding are not supported.
        MessageError, or one of DAMAGED: the message is damaged.
    """

    def read_checked(message: Any) -> PictureSample:
        picture = pictures.read(message)
        if pictures.is_video and picture.encoding not in CODECS:
            known = ", ".join(CODECS)
            raise UnusableError(
                f"video of format {picture.encoding[:24]!r} is not read (only {known})"
            )
        if not pictures.is_video and picture.size is not None:
            _check_pixels(picture, picture.size)
        elif not pictures.is_video and "compressedDepth" in picture.encoding:
            raise UnusableError("compressedDepth pictures are distances, not what a camera sees")
        memoryview(picture.data)  # raises TypeError, as what is damaged does
        return picture

    return read_checked


def _found_in(
    records: Iterable[Record], topic: str, *, trusts_header: bool
) -> Iterator[tuple[bool, int, PictureSample]]:
    """Yield each image with its stamp [ns], and whether it is a video's."""
    readers: dict[RawChannel, tuple[Decode, Callable[[Any], PictureSample], bool]] = {}
    decoders = Decoders(SchemaBudget())
    for record in one_by_one(records):
        if isinstance(record, RawChannel) and record.topic == topic:
            pictures = message_type_of(record)
            if isinstance(pictures, PictureType):
                with suppress(UnusableError):
                    read = checked_pictures(pictures)
                    readers[record] = (decoders.of(record), read, pictures.is_video)
        elif isinstance(record, RawMessage) and record.channel in readers:
            decode, read, is_video = readers[record.channel]
            try:
                picture = read(decode(record.data))
            except (MessageError, UnusableError, *DAMAGED):
                continue
            stamp_ns = picture.stamp_ns if trusts_header and picture.stamp_ns else record.log_ns
            yield is_video, stamp_ns, picture


def _check_pixels(picture: PictureSample, size: tuple[int, int]) -> None:
    """Check that there are as many bytes as size and step claim."""
    try:
        form = pixel_format_of(picture.encoding)
    except LogError as error:
        raise UnusableError(str(error)) from error
    width, height = size
    across, down = form.color_block_px
    if width <= 0 or height <= 0 or width % across or height % down:
        raise MessageError(f"no {picture.encoding} picture is of {width} x {height} px")
    if width * height > MAX_PIXELS:
        raise MessageError(f"a picture claims {width} x {height} px")
    step, rows = _step(picture, width, form), form.rows(height)
    if step < form.row_bytes(width):
        raise MessageError(f"a picture has rows of {width} px in {step} bytes")
    if memoryview(picture.data).nbytes < step * rows:
        raise MessageError(f"a picture has {len(picture.data)} bytes for {rows} rows of {step}")


def _step(picture: PictureSample, width: int, form: PixelFormat) -> int:
    return picture.step or form.row_bytes(width)


def _frame(stamp_ns: int, picture: PictureSample) -> Frame:
    """Return a checked image as a frame."""
    if picture.size is None:
        data = bytes(picture.data)
        # Senders write "jpeg", "jpg", "rgb8; jpeg compressed bgr8", or what it is not.
        return Frame(stamp_ns, image_format(data) or picture.encoding, data)
    form = pixel_format_of(picture.encoding)
    width, height = picture.size
    step, row, rows = _step(picture, width, form), form.row_bytes(width), form.rows(height)
    pixels = np.frombuffer(picture.data, np.uint8, step * rows).reshape(rows, step)[:, :row]
    if picture.is_bigendian and form.sample_bytes == 2:
        pixels = np.ascontiguousarray(pixels).view(">u2").astype("<u2")
    return Frame(stamp_ns, picture.encoding, pixels.tobytes(), picture.size)
