"""Read the images and the sound of one topic from the messages of a log.

Images come one at a time as frames, with their claimed sizes checked before they are decoded; sound
is put together. Unusable messages are left out, and leave a gap in sound.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from heapq import heappop, heappush
from itertools import groupby
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
from tunenet_logs.formats.by_shape import SchemaBudget
from tunenet_logs.formats.message_types import (
    PictureSample,
    PictureType,
    SoundSample,
    SoundType,
    message_type_of,
)
from tunenet_logs.formats.registry import decoder_for
from tunenet_logs.images import MAX_PIXELS, PixelFormat, image_format, pixel_format_of
from tunenet_logs.video import CODECS, Packet, decoded


class Decoders:
    """Factory of message decoders, within a budget of definition bytes."""

    def __init__(self, budget: SchemaBudget) -> None:
        self._budget = budget
        self._made: dict[tuple[str, str, str, bytes], Decode | str] = {}

    def of(self, channel: RawChannel) -> Decode:
        """Return the decoder of a channel, shared by channels of the same definition.

        Raises:
            UnusableError: its messages cannot be decoded.
        """
        key = (channel.encoding, channel.schema_encoding, channel.type_name, channel.schema)
        if key not in self._made:
            try:
                self._budget.spend(channel)
                self._made[key] = decoder_for(channel)
            except UnusableError as reason:
                self._made[key] = str(reason)
        made = self._made[key]
        if isinstance(made, str):
            raise UnusableError(made)
        return made


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


# ---- Sound of one topic, from its messages

_FORMAT = "pcm-s16"  # of the samples: whole numbers of 16 bits, little-endian, channel by channel
_MAX_CHANNELS = 256  # of a sound
# Fraction of a message's rate, a whole number, by which the log's noted rate may differ: no crystal
# is so far off.
_SAME = 1e-3


def checked_sound(kind: SoundType) -> Callable[[Any], SoundSample]:
    """Return a reader of a type's sound that validates each message.

    The reader raises:
        UnusableError: sound of that format is not supported.
        MessageError, or one of DAMAGED: the message is damaged.
    """

    def read_checked(message: Any) -> SoundSample:
        sample = kind.read(message)
        if sample.format != _FORMAT:
            raise UnusableError(
                f"sound of format {sample.format[:24]!r} is not read (only {_FORMAT})"
            )
        if not RATES_HZ[0] <= sample.rate_hz <= RATES_HZ[1]:
            raise MessageError(f"a sound claims {sample.rate_hz} samples a second")
        if not 0 < sample.channels <= _MAX_CHANNELS:
            raise MessageError(f"a sound claims {sample.channels} channels")
        size = memoryview(sample.data).nbytes  # raises TypeError, as what is damaged does
        if size % (2 * sample.channels):
            raise MessageError(f"{size} bytes are no whole samples of {sample.channels} channels")
        return sample

    return read_checked


def sound_of(
    records: Iterable[Record], topic: str, *, trusts_header: bool, exact_hz: float, file_hz: float
) -> Sound:
    """Assemble the sound of a topic from a log's records; unusable messages leave a gap.

    Args:
        records: of the log, perhaps of that topic alone.
        topic: of the sound.
        trusts_header: whether to use the sound's own stamps, where they are set; else the log's.
        exact_hz: sample rate, where the log states it more exactly than a message can; else 0.
        file_hz: sample rate of the file it was recorded from; 0 where it is unknown.
    """
    readers: dict[RawChannel, tuple[Decode, Callable[[Any], SoundSample]]] = {}
    decoders = Decoders(SchemaBudget())
    gathering: _Gathering | None = None
    for record in one_by_one(records):
        if isinstance(record, RawChannel) and record.topic == topic:
            kind = message_type_of(record)
            if isinstance(kind, SoundType):
                with suppress(UnusableError):
                    readers[record] = (decoders.of(record), checked_sound(kind))
        elif isinstance(record, RawMessage) and record.channel in readers:
            decode, read = readers[record.channel]
            try:
                sample = read(decode(record.data))
            except (MessageError, UnusableError, *DAMAGED):
                continue
            stamp_ns = sample.stamp_ns if trusts_header and sample.stamp_ns else record.log_ns
            gathering = gathering or _Gathering(sample, stamp_ns, exact_hz, file_hz)
            gathering.add(sample, stamp_ns)
            if gathering.is_full:
                break
    if gathering is None:
        nothing = np.empty(0, np.float32)
        return Sound(topic, 0, 48_000.0, nothing, 48_000.0, warnings=("it holds no sound",))
    return gathering.sound(topic)


class _Gathering:
    """Assembler of messages with the first one's rate and channels; rates are as in `sound_of`."""

    def __init__(self, first: SoundSample, stamp_ns: int, exact_hz: float, file_hz: float) -> None:
        self._like = (first.rate_hz, first.channels)
        is_close = abs(exact_hz - first.rate_hz) <= max(0.5, _SAME * first.rate_hz)
        is_told = is_close and RATES_HZ[0] <= file_hz <= RATES_HZ[1]
        self._file_hz = file_hz if is_told else float(first.rate_hz)
        rate_hz = exact_hz if is_close else float(first.rate_hz)
        rate_hz = min(max(rate_hz, RATES_HZ[0]), RATES_HZ[1])
        self._gatherer = SoundGatherer(rate_hz, reduced_hz(file_hz) if is_told else 0.0)
        self._start_ns = stamp_ns
        self._others = 0

    @property
    def is_full(self) -> bool:
        return self._gatherer.is_full

    def add(self, sample: SoundSample, stamp_ns: int) -> None:
        if (sample.rate_hz, sample.channels) != self._like:
            self._others += 1
            return
        piece = np.frombuffer(sample.data, "<i2").reshape(-1, sample.channels)
        self._gatherer.add(piece, (stamp_ns - self._start_ns) * 1e-9)

    def sound(self, topic: str) -> Sound:
        found = self._gatherer.result()
        said = [f"{self._others} messages of another rate were left out"] if self._others else []
        return Sound(
            name=topic,
            start_ns=self._start_ns + round(found.start_s * 1e9),
            rate_hz=found.rate_hz,
            samples=found.samples,
            file_rate_hz=self._file_hz,
            channels=self._like[1],
            codec=_FORMAT,
            warnings=(*found.warnings, *said),
        )
