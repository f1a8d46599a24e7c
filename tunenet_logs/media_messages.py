"""Read the images and the sound of one topic from the messages of a log.

Images come one at a time as frames, with their claimed sizes checked before they are decoded; sound
is put together. Unusable messages are left out, and leave a gap in sound.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from heapq import heappop, heappush
from itertools import chain, groupby
from typing import Any

import numpy as np

from tunenet_logs.audio import RATES_HZ, SoundGatherer, reduced_hz
from tunenet_logs.episode import Frame, Sound
from tunenet_logs.errors import LogError
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
from tunenet_logs.formats.message_types import MessageType, PictureSample, message_type_of
from tunenet_logs.images import MAX_PIXELS, image_format, pixel_format_of
from tunenet_logs.video import CODECS, Packet, decoded

_SOUND_FORMAT = "pcm-s16"  # whole numbers of 16 bits, little-endian, channel by channel


def checked(kind: MessageType, message: Any) -> Any:
    """Return the image or sound of a message; UnusableError, MessageError, or one of DAMAGED."""
    sample = kind.read(message)
    if kind.holds == "sound":
        if sample.format != _SOUND_FORMAT:
            raise UnusableError(
                f"sound of format {sample.format[:24]!r} is not read (only {_SOUND_FORMAT})"
            )
        if not RATES_HZ[0] <= sample.rate_hz <= RATES_HZ[1]:
            raise MessageError(f"a sound claims {sample.rate_hz} samples a second")
        if not 0 < sample.channels <= 256:
            raise MessageError(f"a sound claims {sample.channels} channels")
        size = memoryview(sample.data).nbytes  # raises TypeError, as what is damaged does
        if size % (2 * sample.channels):
            raise MessageError(f"{size} bytes are no whole samples of {sample.channels} channels")
    elif kind.is_video:
        if sample.encoding not in CODECS:
            known = ", ".join(CODECS)
            raise UnusableError(
                f"video of format {sample.encoding[:24]!r} is not read (only {known})"
            )
        memoryview(sample.data)  # raises TypeError, as what is damaged does
    else:
        _check_picture(sample)
    return sample


def _samples_of(
    records: Iterable[Record], topic: str, holds: str, trusts_header: bool
) -> Iterator[tuple[bool, int, Any]]:
    """Yield each usable sample of a topic with its stamp [ns], and whether it is a video's."""
    readers: dict[RawChannel, tuple[MessageType, Decode]] = {}
    decoders = Decoders()
    for record in one_by_one(records):
        if isinstance(record, RawChannel) and record.topic == topic:
            kind = message_type_of(record)
            if kind is not None and kind.holds == holds:
                with suppress(UnusableError):
                    readers[record] = kind, decoders.listed_type(record).decode
        elif isinstance(record, RawMessage) and record.channel in readers:
            kind, decode = readers[record.channel]
            try:
                sample = checked(kind, decode(record.data))
            except (MessageError, UnusableError, *DAMAGED):
                continue
            stamp_ns = sample.stamp_ns if trusts_header and sample.stamp_ns else record.log_ns
            yield kind.is_video, stamp_ns, sample


# ---- Images: the frames of one topic


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
    """Yield the frames of a topic in log order, leaving out unusable ones."""
    found = _samples_of(records, topic, "picture", trusts_header)
    for is_video, group in groupby(found, key=lambda each: each[0]):
        if is_video:
            yield from decoded(
                Packet(stamp_ns, picture.encoding, bytes(picture.data))
                for _, stamp_ns, picture in group
            )
        else:
            yield from (_frame(stamp_ns, picture) for _, stamp_ns, picture in group)


def _check_picture(picture: PictureSample) -> None:
    """Check that there are as many bytes as size and step claim."""
    if picture.size is None:
        if "compressedDepth" in picture.encoding:
            raise UnusableError("compressedDepth pictures are distances, not what a camera sees")
        memoryview(picture.data)
        return
    try:
        form = pixel_format_of(picture.encoding)
    except LogError as error:
        raise UnusableError(str(error)) from error
    width, height = picture.size
    across, down = form.color_block_px
    if width <= 0 or height <= 0 or width % across or height % down:
        raise MessageError(f"no {picture.encoding} picture is of {width} x {height} px")
    if width * height > MAX_PIXELS:
        raise MessageError(f"a picture claims {width} x {height} px")
    step, rows = picture.step or form.row_bytes(width), form.rows(height)
    if step < form.row_bytes(width):
        raise MessageError(f"a picture has rows of {width} px in {step} bytes")
    if memoryview(picture.data).nbytes < step * rows:
        raise MessageError(f"a picture has {len(picture.data)} bytes for {rows} rows of {step}")


def _frame(stamp_ns: int, picture: PictureSample) -> Frame:
    """Return a checked image as a frame."""
    if picture.size is None:
        data = bytes(picture.data)
        # Senders write "jpeg", "jpg", "rgb8; jpeg compressed bgr8", or what it is not.
        return Frame(stamp_ns, image_format(data) or picture.encoding, data)
    form = pixel_format_of(picture.encoding)
    width, height = picture.size
    row, rows = form.row_bytes(width), form.rows(height)
    step = picture.step or row
    pixels = np.frombuffer(picture.data, np.uint8, step * rows).reshape(rows, step)[:, :row]
    if picture.is_bigendian and form.sample_bytes == 2:
        pixels = np.ascontiguousarray(pixels).view(">u2").astype("<u2")
    return Frame(stamp_ns, picture.encoding, pixels.tobytes(), picture.size)


# ---- Sound of one topic, from its messages


def sound_of(
    records: Iterable[Record], topic: str, *, trusts_header: bool, exact_hz: float, file_hz: float
) -> Sound:
    """Assemble the sound of a topic from a log's records; unusable messages leave a gap.

    The first message says the rate and the channels; of another rate they are left out. `exact_hz`
    is the rate where the log states it more exactly than a message can, `file_hz` that of the file
    it was recorded from; else 0.
    """
    samples = _samples_of(records, topic, "sound", trusts_header)
    first = next(samples, None)
    if first is None:
        nothing = np.empty(0, np.float32)
        return Sound(topic, 0, 48_000.0, nothing, 48_000.0, warnings=("it holds no sound",))
    _, start_ns, like = first
    # A message's rate is a whole number, and no crystal is off by more than a thousandth.
    is_close = abs(exact_hz - like.rate_hz) <= max(0.5, 1e-3 * like.rate_hz)
    is_told = is_close and RATES_HZ[0] <= file_hz <= RATES_HZ[1]
    rate_hz = min(max(exact_hz if is_close else float(like.rate_hz), RATES_HZ[0]), RATES_HZ[1])
    gatherer = SoundGatherer(rate_hz, reduced_hz(file_hz) if is_told else 0.0)
    others = 0
    for _, stamp_ns, sample in chain((first,), samples):
        if (sample.rate_hz, sample.channels) != (like.rate_hz, like.channels):
            others += 1
        else:
            piece = np.frombuffer(sample.data, "<i2").reshape(-1, sample.channels)
            gatherer.add(piece, (stamp_ns - start_ns) * 1e-9)
        if gatherer.is_full:
            break
    found = gatherer.result()
    said = [f"{others} messages of another rate were left out"] if others else []
    return Sound(
        name=topic,
        start_ns=start_ns + round(found.start_s * 1e9),
        rate_hz=found.rate_hz,
        samples=found.samples,
        file_rate_hz=file_hz if is_told else float(like.rate_hz),
        channels=like.channels,
        codec=_SOUND_FORMAT,
        warnings=(*found.warnings, *said),
    )
