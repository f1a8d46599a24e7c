"""Read the images and the sound of one topic from the messages of a log.

Images come one at a time as frames, with their claimed sizes checked before they are decoded; sound
is put together. Unusable messages are left out, and leave a gap in sound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
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
    AnyType,
    MessageError,
    RawChannel,
    RawMessage,
    Record,
    UnusableError,
    one_by_one,
)
from tunenet_logs.formats.decoders import SchemaBudget, listed_type
from tunenet_logs.formats.message_types import (
    PictureSample,
    PictureType,
    SoundSample,
    SoundType,
    message_type_of,
)
from tunenet_logs.images import MAX_PIXELS, image_format, pixel_format_of
from tunenet_logs.video import CODECS, Packet, decoded

_SOUND_FORMAT = "pcm-s16"  # whole numbers of 16 bits, little-endian, channel by channel
_MAX_CHANNELS = 256  # of a sound
# Fraction of a message's rate, a whole number, by which the log's noted rate may differ: no crystal
# is so far off.
_SAME = 1e-3


class Decoders:
    """Factory of message decoders, within a budget of definition bytes."""

    def __init__(self, budget: SchemaBudget) -> None:
        self._budget = budget
        self._made: dict[tuple[str, str, str, bytes], AnyType | str] = {}

    def of(self, channel: RawChannel) -> AnyType:
        """Return how a channel is decoded, shared by channels of the same definition.

        Raises:
            UnusableError: its messages cannot be decoded.
        """
        key = (channel.encoding, channel.schema_encoding, channel.type_name, channel.schema)
        if key not in self._made:
            try:
                self._budget.spend(channel)
                self._made[key] = listed_type(channel)
            except UnusableError as reason:
                self._made[key] = str(reason)
        made = self._made[key]
        if isinstance(made, str):
            raise UnusableError(made)
        return made


def checked(kind: PictureType | SoundType) -> Callable[[Any], Any]:
    """Return a reader of a type's images or sound that validates each of them.

    The reader raises:
        UnusableError: its encoding is not supported.
        MessageError, or one of DAMAGED: the message is damaged.
    """
    if isinstance(kind, SoundType):
        check: Callable[[Any], None] = _check_sound
    else:
        check = _check_video if kind.is_video else _check_picture

    def read_checked(message: Any) -> Any:
        sample = kind.read(message)
        check(sample)
        return sample

    return read_checked


def _samples_of(
    records: Iterable[Record], topic: str, kinds: type[PictureType | SoundType], trusts_header: bool
) -> Iterator[tuple[bool, int, Any]]:
    """Yield each usable sample of a topic with its stamp [ns], and whether it is a video's."""
    readers: dict[RawChannel, Callable[[Any], Any]] = {}
    videos: set[RawChannel] = set()
    decoders = Decoders(SchemaBudget())
    for record in one_by_one(records):
        if isinstance(record, RawChannel) and record.topic == topic:
            kind = message_type_of(record)
            if isinstance(kind, kinds):
                with suppress(UnusableError):
                    decode, read = decoders.of(record).decode, checked(kind)
                    readers[record] = lambda data, decode=decode, read=read: read(decode(data))
                    if isinstance(kind, PictureType) and kind.is_video:
                        videos.add(record)
        elif isinstance(record, RawMessage) and record.channel in readers:
            try:
                sample = readers[record.channel](record.data)
            except (MessageError, UnusableError, *DAMAGED):
                continue
            stamp_ns = sample.stamp_ns if trusts_header and sample.stamp_ns else record.log_ns
            yield record.channel in videos, stamp_ns, sample


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
    """Yield the frames of a topic in log order, leaving out unusable ones.

    Args:
        records: of the log, perhaps of that topic alone.
        topic: of the images.
        trusts_header: whether to use header stamps, where they are set; else the log's.
    """
    found = _samples_of(records, topic, PictureType, trusts_header)
    for is_video, group in groupby(found, key=lambda each: each[0]):
        if is_video:
            yield from decoded(
                Packet(stamp_ns, picture.encoding, bytes(picture.data))
                for _, stamp_ns, picture in group
            )
        else:
            yield from (_frame(stamp_ns, picture) for _, stamp_ns, picture in group)


def _check_video(picture: PictureSample) -> None:
    if picture.encoding not in CODECS:
        known = ", ".join(CODECS)
        raise UnusableError(f"video of format {picture.encoding[:24]!r} is not read (only {known})")
    memoryview(picture.data)  # raises TypeError, as what is damaged does


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


def _check_sound(sample: SoundSample) -> None:
    if sample.format != _SOUND_FORMAT:
        raise UnusableError(
            f"sound of format {sample.format[:24]!r} is not read (only {_SOUND_FORMAT})"
        )
    if not RATES_HZ[0] <= sample.rate_hz <= RATES_HZ[1]:
        raise MessageError(f"a sound claims {sample.rate_hz} samples a second")
    if not 0 < sample.channels <= _MAX_CHANNELS:
        raise MessageError(f"a sound claims {sample.channels} channels")
    size = memoryview(sample.data).nbytes  # raises TypeError, as what is damaged does
    if size % (2 * sample.channels):
        raise MessageError(f"{size} bytes are no whole samples of {sample.channels} channels")


def sound_of(
    records: Iterable[Record], topic: str, *, trusts_header: bool, exact_hz: float, file_hz: float
) -> Sound:
    """Assemble the sound of a topic from a log's records; unusable messages leave a gap.

    The first message says the rate and the channels; of another rate they are left out.

    Args:
        records: of the log, perhaps of that topic alone.
        topic: of the sound.
        trusts_header: whether to use the sound's own stamps, where they are set; else the log's.
        exact_hz: sample rate, where the log states it more exactly than a message can; else 0.
        file_hz: sample rate of the file it was recorded from; 0 where it is unknown.
    """
    samples = _samples_of(records, topic, SoundType, trusts_header)
    first = next(samples, None)
    if first is None:
        nothing = np.empty(0, np.float32)
        return Sound(topic, 0, 48_000.0, nothing, 48_000.0, warnings=("it holds no sound",))
    _, start_ns, like = first
    is_close = abs(exact_hz - like.rate_hz) <= max(0.5, _SAME * like.rate_hz)
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
