"""Signals, frames, sound, and the episode that holds them: the data types of all packages.

Whoever leaves samples out counts them by the reason, beside those that remain (`LeftOut`): so a
tuning, a check and an import say the same of them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


Array = NDArray[np.float64]  # real numbers; the shape is said where it is used
# Pixels: (height, width, 3) of RGB, or of BGR where it is said, or (height, width) of grey.
Picture = NDArray[np.uint8]
COMMANDS = "commands"  # ends the name of a robot's commanded joints, before their quantity
UNSTATED = ""  # the unit of lengths of which nobody says what they are
# What a stamp counts for each frame where nothing says how many there are in a second.
FRAME_NS = 10_000_000


def median_step(times: NDArray[Any], lag: int = 1) -> float:
    """Return the median step of stamps, shape (..., T), in their unit, taken over `lag` of them."""
    return float(np.median(times[..., lag:] - times[..., :-lag])) / lag


@dataclass(frozen=True, eq=False)
class Signal:
    """Sampled quantity.

    Attributes:
        name: topic it came from, or the name it goes by.
        stamps_ns: acquisition times [ns], int64, shape (T,), strictly increasing.
        values: float64, shape (T, C), read-only; NaN only where a sample is missing.
        columns: the C names of the channels.
        unit: unit of all values ("m", "rad", "N·m", "A", "px", "1"); `UNSTATED` of a position in an
            unknown unit of length.
        counts_frames: whether the stamps count frames, `FRAME_NS` each, whose rate is unknown.
        drives: whether it is an input, a command or a force, and not how something moves; see
            `without_commands`.
        frame: in which its values are, as the log calls it; "" where it does not say.
        left_out: samples that the log had besides, by the reason; see `left_out`.

    Raises:
        ValueError: shapes disagree, or the stamps do not increase.
    """

    name: str
    stamps_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    columns: tuple[str, ...]
    unit: str
    counts_frames: bool = False
    drives: bool = False
    frame: str = ""
    left_out: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, dtype in (("stamps_ns", np.int64), ("values", np.float64)):
            array = getattr(self, name)
            # A read-only array stays as it is, since it may be large; any other is copied.
            is_kept = isinstance(array, np.ndarray) and array.dtype == dtype
            if not is_kept or not array.flags.c_contiguous or array.flags.writeable:
                array = np.array(array, dtype, order="C")
                array.flags.writeable = False
            object.__setattr__(self, name, array)
        expected = (len(self.stamps_ns), len(self.columns))
        if self.stamps_ns.ndim != 1 or self.values.shape != expected:
            raise ValueError(
                f"{self.name}: values have shape {self.values.shape}, expected {expected}"
            )
        if np.any(np.diff(self.stamps_ns) <= 0):
            raise ValueError(f"{self.name}: stamps do not increase strictly")
        object.__setattr__(self, "left_out", MappingProxyType(dict(self.left_out)))

    @property
    def is_position(self) -> bool:
        """Whether it is a position, in m or in a unit that a drop may calibrate."""
        return self.columns == ("x", "y", "z") and self.unit in ("m", "px", UNSTATED)

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Times since the first sample, shape (T,) [s]."""
        return (self.stamps_ns - self.stamps_ns[:1]).astype(np.float64) * 1e-9

    @property
    def rate_hz(self) -> float:
        """Median sampling rate [Hz]; 0 with fewer than two samples."""
        return 1e9 / median_step(self.stamps_ns) if len(self.stamps_ns) > 1 else 0.0


@dataclass(frozen=True, eq=False)
class Frame:
    """Image as it was recorded: never decoded and encoded again on its way.

    Attributes:
        stamp_ns: acquisition time [ns].
        encoding: format of `data`: "jpeg", "png" or "webp", or of bare pixels, as sensor_msgs/Image
            names it ("rgb8", "mono8", "bayer_rggb8", ...); a decoded video's are "rgb8".
        data: the bytes; of bare pixels without padding between rows, and little-endian.
        size: (width, height) [px] of bare pixels; None where `data` says it itself.
        pixels: of a decoded video, in place of `data`, which is empty: gives RGB, reduced by a
            whole number; see `decode`.
    """

    stamp_ns: int
    encoding: str
    data: bytes
    size: tuple[int, int] | None = None
    pixels: Callable[[int], NDArray[np.uint8]] | None = None

    def decode(self, scale: int = 1) -> NDArray[np.uint8]:
        """Decode to RGB, uint8, shape (H, W, 3).

        It is reduced by `scale`: each pixel is the mean of so many across and down, and what is
        left over at two edges is cut. A multiple of `coarse` is decoded soonest. LogError if
        damaged, of an unknown encoding, or larger than any camera's picture.
        """
        if self.pixels is not None:
            return self.pixels(scale)
        from tunenet_logs.images import decode_image, decode_pixels, mean_of_blocks

        if self.size is not None:
            picture = decode_pixels(self.data, self.encoding, self.size)
        elif (part := self.coarse) > 1 and scale % part == 0:
            width, height = self.size_px()
            picture = decode_image(self.data, self.encoding, max(width, height) // part)
            picture = mean_of_blocks(picture, scale // part)
            return picture[: height // scale, : width // scale]
        else:
            picture = decode_image(self.data, self.encoding)
        return mean_of_blocks(picture, scale)

    @property
    def coarse(self) -> int:
        """By what a large JPEG is reduced while it is decoded, at a tenth of the cost; else 1."""
        from tunenet_logs.images import LARGE_PIXELS, LARGE_REDUCED, image_format

        is_jpeg = self.pixels is None and self.size is None and image_format(self.data) == "jpeg"
        return LARGE_REDUCED if is_jpeg and math.prod(self.size_px()) > LARGE_PIXELS else 1

    def size_px(self) -> tuple[int, int]:
        """Return (width, height) without decoding the image.

        LogError if the header is damaged, or claims more than any camera's picture.
        """
        if self.size is not None:
            return self.size
        from tunenet_logs.images import image_size

        return image_size(self.data)

    def work_px(self) -> int:
        """Return the pixels that decoding passes over; a forged image may have more than it shows.

        LogError as by `size_px`.
        """
        if self.size is not None:
            return math.prod(self.size)
        from tunenet_logs.images import image_work_px

        return image_work_px(self.data)


@dataclass(frozen=True, kw_only=True)
class EpisodeInfo:
    """Metadata of an episode.

    Attributes:
        kind: "drop", "payload", "bounce-shot", or "" where unknown.
        source: what recorded it, in words.
        preset: simulator preset it was recorded with, or "".
        rig: known measures of the set-up: `ball_diameter_m`, `drop_height_m`, ...
        truth: parameters that a simulator used. Never an input of an estimator.
        counts: what the recorder counted: `captured`, `written`, `dropped`.
        notes: anything else in words: `seed`, why a recording ended, ...
    """

    kind: str = ""
    source: str = ""
    preset: str = ""
    rig: Mapping[str, float] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("rig", "truth", "counts", "notes"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def to_strings(self) -> dict[str, str]:
        """Serialise to the flat record of strings that a log holds."""
        # By its version, a later reader can tell what it reads.
        record = {"version": "1", "kind": self.kind, "source": self.source, "preset": self.preset}
        for group in ("rig", "truth", "counts", "notes"):
            for key, value in getattr(self, group).items():
                record[f"{group}.{key}"] = value if isinstance(value, str) else repr(value)
        return record

    def news(self, told: Mapping[str, str]) -> dict[str, str]:
        """Return the part of that record which is not `told` yet."""
        return {key: one for key, one in self.to_strings().items() if told.get(key) != one}

    @classmethod
    def from_strings(cls, record: Mapping[str, str]) -> EpisodeInfo:
        """Parse that record; what is not understood or not finite is left out."""
        groups: dict[str, dict[str, Any]] = {"rig": {}, "truth": {}, "counts": {}, "notes": {}}
        for key, text in record.items():
            group, _, name = key.partition(".")
            if group in ("rig", "truth"):
                with suppress(ValueError):
                    if math.isfinite(number := float(text)):
                        groups[group][name] = number
            elif group == "counts" and text.isascii() and text.isdecimal() and len(text) < 19:
                groups[group][name] = int(text)
            elif group == "notes":
                groups[group][name] = text
        texts: dict[str, Any] = {
            name: record.get(name, "") for name in ("kind", "source", "preset")
        }
        texts.update(groups)
        return cls(**texts)

    def ended(self, reason: str, **counts: int) -> EpisodeInfo:
        """Return a copy with the recorder's counts, and why it ended if not by itself."""
        notes = {**self.notes, "ended": reason} if reason else self.notes
        return replace(self, counts={**self.counts, **counts}, notes=notes)


@dataclass(frozen=True, eq=False)
class Channel:
    """Channel of a log, as `tunenet-logs info` shows it."""

    topic: str
    type_name: str
    encoding: str
    # the log's own stamps of its messages [ns], int64, shape (T,), in file order
    log_ns: NDArray[np.int64]
    skipped: str | None = None  # why its messages are not used; None where they are
    pictures: bool = False  # whether its messages are images that `Episode.frames` gives
    drives: bool = False  # whether they are commands or forces; see `Signal.drives`
    sounds: bool = False  # whether they are sound that `Episode.sounds` gives
    # pictures or pieces of sound that it had besides, by the reason; see `left_out`
    left_out: Mapping[str, int] = field(default_factory=dict)

    @property
    def messages(self) -> int:
        """Number of messages."""
        return len(self.log_ns)


@dataclass(frozen=True, eq=False)
class Episode:
    """One recorded experiment.

    Attributes:
        info: its metadata.
        signals: by name (a log's topic).
        channels: every channel of the log, those that were skipped too.
        warnings: what was lost, repaired or doubtful on the way, in words.
        losses: those of them that mean damage: where it is, and how much was lost.
        tainted: why samples that were read may be wrong; "" where nothing speaks for that.
        open_frames: opens a fresh iterator over the frames of one of `picture_topics`.
        frames_untimed: whether the stamps of frames count them, `FRAME_NS` each: then a video gives
            a coefficient of restitution, but no height and no speed.
        open_sound: decodes the sound of one of `sound_topics`.
    """

    info: EpisodeInfo
    signals: Mapping[str, Signal]
    channels: tuple[Channel, ...] = ()
    warnings: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()
    tainted: str = ""
    open_frames: Callable[[str], Iterator[Frame]] | None = None
    frames_untimed: bool = False
    open_sound: Callable[[str], Sound] | None = None

    @property
    def picture_topics(self) -> tuple[str, ...]:
        """Topics of images, in the order of the log."""
        return tuple(one.topic for one in self.channels if one.pictures and one.skipped is None)

    @property
    def sound_topics(self) -> tuple[str, ...]:
        """Topics of sound, in the order of the log."""
        return tuple(one.topic for one in self.channels if one.sounds and one.skipped is None)

    def signals_of(self, topic: str) -> tuple[Signal, ...]:
        """Return the signals that came from a topic, or the one of that name."""
        if topic in self.signals:
            return (self.signals[topic],)
        return tuple(one for name, one in self.signals.items() if name.startswith(f"{topic}."))

    def frames(self, topic: str | None = None) -> Iterator[Frame]:
        """Iterate over the images of a topic (the first if None) in the order of the log."""
        topics = self.picture_topics
        if self.open_frames is None or not topics:
            return iter(())
        return self.open_frames(topic or topics[0])

    def sounds(self, topic: str | None = None) -> Sound | None:
        """Decode the sound of a topic (the first if None); None where there is none.

        What is damaged is left out, and said in its warnings; it may hold no sample at all.
        """
        topics = self.sound_topics
        if self.open_sound is None or not topics:
            return None
        return self.open_sound(topic or topics[0])

    def to_pandas(self) -> pd.DataFrame:
        """Return all signals in one table: index `stamp_ns`, columns (signal, column)."""
        import pandas as pd

        tables = {
            name: pd.DataFrame(
                signal.values,
                index=pd.Index(signal.stamps_ns, name="stamp_ns"),
                columns=list(signal.columns),
            )
            for name, signal in self.signals.items()
        }
        return pd.concat(tables, axis=1) if tables else pd.DataFrame()


# ---- Left-out samples: counted by reason, and how many may be

MAX_LEFT_OUT = 0.02  # of all samples of a signal: beyond it what remains is not taken for the whole
# In the record of a recovered log: what of the damaged one it does not hold, of 1.
SHARE_NOTE = "lost_share"
BY_CLOCK = "by a clock that was set"
SAME_STAMP = "with the stamp of another sample"
DAMAGED_MESSAGES = "in damaged messages"
NOT_READ = "in messages that are not read"
UNREADABLE = "in rows that cannot be read"
INCOMPLETE = "without all coordinates"
IMPLAUSIBLE = "beyond what anything measures"
LOST = "in damaged places"
NOT_LATER = "not later than the one before"


class LeftOut(NamedTuple):
    """Number of samples left out of a signal or topic, by reason."""

    name: str  # of a signal, or of a topic of pictures or sound
    used: int  # samples that remain
    by_reason: Mapping[str, int]  # the others

    @classmethod
    def of_signal(cls, signal: Signal) -> LeftOut:
        """Return what is left out of a signal."""
        return cls(signal.name, len(signal.stamps_ns), signal.left_out)

    @classmethod
    def of_channel(cls, channel: Channel) -> LeftOut:
        """Return what is left out of a channel of pictures or sound."""
        inside = channel.left_out.get(BY_CLOCK, 0)  # the others are no messages
        return cls(channel.topic, channel.messages - inside, channel.left_out)

    @property
    def share(self) -> float:
        """Fraction of all samples."""
        count = sum(self.by_reason.values())
        return count / (count + self.used) if count else 0.0

    def __str__(self) -> str:
        count = sum(self.by_reason.values())
        reasons = sorted(self.by_reason.items(), key=lambda reason: -reason[1])
        why = ", ".join(f"{number} {reason}" for reason, number in reasons if number)
        return f"{self.name}: {count} of {count + self.used} samples are left out ({why})"


def left_out_of(episode: Episode) -> list[LeftOut]:
    """List the signals and channels of an episode that lack samples."""
    channels = (one for one in episode.channels if (one.pictures or one.sounds) and not one.skipped)
    found = [LeftOut.of_signal(signal) for signal in episode.signals.values()]
    found += [LeftOut.of_channel(channel) for channel in channels]
    return [one for one in found if one.share]


def added(known: Mapping[str, int], more: Mapping[str, int]) -> dict[str, int]:
    """Add two counts by reason, without reasons that leave nothing out."""
    counts = {reason: known.get(reason, 0) + more.get(reason, 0) for reason in (*known, *more)}
    return {reason: count for reason, count in counts.items() if count}


def in_proportion(samples: int, lost: float, read: float) -> int:
    """Estimate the number of missing samples from the lost share of messages, rows or bytes."""
    return round(samples * lost / read) if read > 0 else 0


def as_note(by_reason: Mapping[str, int]) -> str:
    """Serialise the counts for a log's info record."""
    return json.dumps(dict(by_reason))


def of_note(text: str) -> dict[str, int]:
    """Parse such counts; what is none is left out."""
    try:
        found = json.loads(text) if len(text) < 1000 else None
    except (ValueError, RecursionError):
        return {}
    pairs = found.items() if isinstance(found, dict) else ()
    return {key: one for key, one in pairs if type(one) is int and 0 < one < 2**53}


def share_of_note(values: Mapping[str, str]) -> float:
    """Return the share of a log that was lost before its copy was recovered."""
    try:
        share = float(values.get(SHARE_NOTE, "0"))
    except ValueError:
        return 0.0
    return share if 0 < share < 1 else 0.0


# ---- Coordinate frame: whether all messages of a topic share one


@dataclass
class OneFrame:
    """Common coordinate frame of a topic's messages."""

    name: str = ""  # of the one that all had; "" where they differ, or none was named
    _is_told: bool = False

    def add(self, name: str) -> None:
        """Register the frame of one more message."""
        if not self._is_told:
            self.name, self._is_told = name, True
        elif name != self.name:
            self.name = ""


# ---- Sound, recorded by a microphone beside the pictures, or alone


@dataclass(frozen=True, eq=False)
class Sound:
    """Sound track."""

    name: str  # of its topic
    start_ns: int  # stamp of the first sample, on the log's clock
    # samples in a second of the log's clock: that of the pictures, so that sound which was slowed
    # down with its video has more than its file says
    rate_hz: float
    samples: NDArray[np.float32]  # of all channels together, full scale 1, shape (N,)
    file_rate_hz: float  # as the file says
    channels: int = 1  # that there were
    codec: str = ""  # as the file names it
    warnings: tuple[str, ...] = ()  # what a user should know, in words

    @property
    def lasts_s(self) -> float:
        """Duration on the log's clock [s]."""
        return len(self.samples) / self.rate_hz
