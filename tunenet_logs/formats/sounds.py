"""Assemble the sound of one topic from its messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import numpy as np

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
from tunenet_logs.formats.gathered_sound import RATES_HZ, SoundGatherer, reduced_hz
from tunenet_logs.formats.message_types import SoundSample, SoundType, message_type_of
from tunenet_logs.sound import Sound

_FORMAT = "pcm-s16"  # of the samples: whole numbers of 16 bits, little-endian, channel by channel
_MAX_CHANNELS = 256  # of a sound
# Of its rate, that a sound has more or fewer samples on the log's clock: no crystal is so far off,
# and a message's rate is a whole number.
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
