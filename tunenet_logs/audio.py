"""Read the sound of files and videos as mono samples on a log's clock.

`SoundGatherer` joins packets, their gaps filled with silence, to samples of bounded length and
rate. A `SoundTrack` has the times of a file's packets and decodes them on demand; `film_sound`
aligns one with its video's frames, `read_sound` reads a file of sound alone, and `sound_blocks`
cuts a sound into a log's messages.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Sound
from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.media import SOUNDS, VideoClock, creation_ns, opened_media
from tunenet_logs.messages import AUDIO_TOPIC

if TYPE_CHECKING:
    from av import AudioFrame
    from av.container import InputContainer


MAX_S = 600.0  # [s] of sound that is used
_KEPT_HZ = 48_000  # a higher sample rate is divided by a whole number, to this at most
# Slowest and fastest sample rate; speech by telephone has 8,000, a bat detector 500,000.
RATES_HZ = (1_000.0, 2_000_000.0)
# Full scale of integer samples, by NumPy's name of their type.
_FULL_SCALE = {"u1": 2.0**7, "i2": 2.0**15, "i4": 2.0**31, "i8": 2.0**63}


@dataclass(frozen=True, eq=False)
class GatheredSound:
    """Assembled audio."""

    samples: NDArray[np.float32]  # mean of all channels, full scale 1, shape (N,)
    start_s: float  # time of the first sample, on the clock of the packets [s]
    rate_hz: float  # samples in a second of that clock
    warnings: tuple[str, ...]  # what was repaired, left out or is doubtful, in words


class SoundGatherer:
    """Assembler of audio packets, of `rate_hz` samples in a second.

    A gap between two is filled with silence of its length, so that what follows keeps its time.
    `heard_hz` is the rate at a microphone, where the clock is that of a slow-motion video.
    """

    def __init__(self, rate_hz: float, heard_hz: float = 0.0) -> None:
        low, high = RATES_HZ
        if not low <= rate_hz <= high:
            raise ValueError(f"claims {rate_hz:.6g} samples a second")
        self._file_hz = float(rate_hz)
        heard_hz = heard_hz if low <= heard_hz <= high else self._file_hz
        self._every = max(1, math.ceil(heard_hz / _KEPT_HZ))
        self._most = int(MAX_S * heard_hz)  # samples, before they are reduced
        self._pieces: list[NDArray[np.float32]] = []
        self._rest = np.empty(0, np.float32)  # what is not yet a sample that is kept
        self._offsets_s: list[float] = []  # of the pieces before the first hole
        self._base_s, self._base_count = 0.0, 0  # from where pieces are counted
        self._count = self._values = self._calls = 0
        self._bad = self._holes = self._backwards = 0
        self._hole_s = 0.0
        self._why_full = ""

    @property
    def is_full(self) -> bool:
        """Whether further packets are ignored."""
        return bool(self._why_full)

    def add(self, piece: NDArray[Any], at_s: float | None) -> None:
        """Append a packet of whole numbers or floats as a file has them, shape (N, channels).

        `at_s` is the time of its first sample [s]; None where it follows upon the last.
        """
        self._calls += 1
        self._values += piece.size
        # Ten minutes of eight channels at 48 kHz.
        if self._values > 240_000_000 or self._calls > 1_000_000:
            self._why_full = self._why_full or "the rest is too much"
        if self.is_full or not piece.size:
            return
        if at_s is not None:
            self._place(at_s)
        # The mean of the channels, full scale 1; what is no number is dealt with below.
        with np.errstate(all="ignore"):
            mean = piece.mean(axis=1, dtype=np.float64)
            kind = piece.dtype.str[1:]
            mean -= 128.0 if kind == "u1" else 0.0
            mono = np.asarray(mean / _FULL_SCALE.get(kind, 1.0), np.float32)
        # Decoders give a little more than 1 where a sound was clipped.
        is_bad = ~np.isfinite(mono) | (np.abs(mono) > 8.0)
        if is_bad.any():
            self._bad += int(is_bad.sum())
            mono[is_bad] = 0.0
        self._append(mono)

    def result(self) -> GatheredSound:
        """Return the audio assembled so far."""
        samples = np.concatenate(self._pieces) if self._pieces else np.empty(0, np.float32)
        samples.flags.writeable = False
        start_s = float(np.median(self._offsets_s)) if self._offsets_s else 0.0
        middle_s = (self._every - 1) / 2 / self._file_hz  # of the samples that became one
        rate_hz = self._file_hz / self._every
        said: list[str] = []
        if not len(samples):
            said.append("the sound track holds no sound")
        elif float(np.abs(samples).max()) < 2e-5:  # less than the last of 16 bits
            said.append("the sound track is silent")
        if self._why_full:
            used_s = len(samples) * self._every / self._file_hz
            said.append(f"only the first {used_s:.1f} s of the sound are used: {self._why_full}")
        if self._every > 1:
            said.append(f"the sound was reduced from {self._file_hz:g} to {rate_hz:g} Hz")
        if self._bad:
            said.append(f"{self._bad} samples that are no numbers, or far too loud, became silence")
        if self._holes:
            holes = "1 hole" if self._holes == 1 else f"{self._holes} holes"
            said.append(f"{holes} in the sound, {self._hole_s:.2f} s in all")
        if self._backwards:
            said.append(f"the times of the sound run backwards {self._backwards} times")
        return GatheredSound(samples, start_s + middle_s, rate_hz, tuple(said))

    def _place(self, at_s: float) -> None:
        """Fill a gap before a packet with silence, or count a step backwards."""
        if not np.isfinite(at_s):
            return
        if not self._offsets_s:
            self._base_s, self._base_count = at_s, self._count
        late_s = at_s - self._base_s - (self._count - self._base_count) / self._file_hz
        if abs(late_s) <= 0.03:  # files round it to ms, or to a packet
            if not self._holes and not self._backwards:
                self._offsets_s.append(at_s - self._count / self._file_hz)
            return
        if late_s < 0:
            self._backwards += 1
            self._base_s, self._base_count = at_s, self._count
            return
        self._holes += 1
        self._hole_s += late_s
        count = round(min(late_s * self._file_hz, self._most - self._count))
        begun = min(count, -len(self._rest) % self._every)  # to end a sample that was begun
        self._append(np.zeros(begun, np.float32))
        kept, rest = divmod(count - begun, self._every)
        self._count += kept * self._every
        self._pieces.append(np.zeros(kept, np.float32))
        self._append(np.zeros(rest, np.float32))

    def _append(self, mono: NDArray[np.float32]) -> None:
        most = self._most - self._count
        if len(mono) > most:
            mono = mono[:most]
            self._why_full = f"{MAX_S / 60:g} minutes are enough"
        self._count += len(mono)
        if self._every == 1:
            self._pieces.append(mono)
            return
        mono = np.concatenate((self._rest, mono))
        whole = len(mono) // self._every * self._every
        self._rest = mono[whole:]
        self._pieces.append(mono[:whole].reshape(-1, self._every).mean(axis=1, dtype=np.float32))


def reduced_hz(rate_hz: float) -> float:
    """Return the sample rate kept of a sound, after decimation by an integer."""
    return rate_hz / max(1, math.ceil(rate_hz / _KEPT_HZ))


# ---- Sound track of a file: packet times at once, samples on demand

_MAX_PACKETS = 250_000  # whose times are listed: an hour and a half of AAC


@dataclass(frozen=True, eq=False)
class SoundTrack:
    """Sound track of a file, as the file describes it."""

    path: Path
    formats: str  # allowed ones; see `opened_media`
    index: int  # of the stream among those of sound
    codec: str  # as FFmpeg calls it
    channels: int  # stated by the file
    rate_hz: float  # stated by the file, which need not be what its decoder gives
    packets_s: NDArray[np.float64]  # begin of each packet, on the file's clock, shape (P,) [s]
    lasts_s: float  # to the end of the last packet [s]
    start_ns: int = 0  # the log's stamp of `origin_s`
    origin_s: float | None = None  # on the file's clock [s]; None for the first sample
    # Seconds of the log's clock in one of the file's: below 1 for sound that was slowed down with
    # its video.
    slow: float = 1.0
    warnings: tuple[str, ...] = ()  # what is doubtful, in words

    def sound(self, _topic: str = AUDIO_TOPIC) -> Sound:
        """Decode the samples; a damaged track ends at the damage."""
        said: list[str] = []
        gathered, file_hz, channels = self._decoded(said)
        after_s = 0.0
        if self.origin_s is not None and len(gathered.samples):
            after_s = (gathered.start_s - self.origin_s) * self.slow
        return Sound(
            name=AUDIO_TOPIC,
            start_ns=self.start_ns + round(after_s * 1e9),
            rate_hz=gathered.rate_hz / self.slow,
            samples=gathered.samples,
            file_rate_hz=file_hz,
            channels=channels,
            codec=self.codec,
            warnings=(*self.warnings, *gathered.warnings, *said),
        )

    def channel(self) -> Channel:
        """Return the sound as a channel, each packet a message."""
        origin_s = self.packets_s[0] if self.origin_s is None else self.origin_s
        after_s = (self.packets_s - origin_s) * self.slow
        log_ns = self.start_ns + np.round(after_s * 1e9).astype(np.int64)
        return Channel(AUDIO_TOPIC, self.codec, "audio", log_ns, sounds=True)

    def _decoded(self, said: list[str]) -> tuple[GatheredSound, float, int]:
        """Return the samples, their rate in the file [Hz], and the number of channels."""
        gatherer: SoundGatherer | None = None
        rate_hz, channels = self.rate_hz, self.channels
        try:
            for frame in self._frames(said):
                if gatherer is None:
                    rate_hz, channels = float(frame.sample_rate), len(frame.layout.channels)
                    gatherer = SoundGatherer(rate_hz)
                elif frame.sample_rate != rate_hz:
                    said.append(f"the sound ends where its rate changes to {frame.sample_rate} Hz")
                    break
                time_base = frame.time_base
                at_s = None if frame.pts is None or not time_base else float(frame.pts * time_base)
                piece = frame.to_ndarray()
                is_planar = frame.format.is_planar
                gatherer.add(piece.T if is_planar else piece.reshape(frame.samples, -1), at_s)
                if gatherer.is_full:
                    break
        except LogError as error:
            said.append(f"the sound is damaged: {error.what.removeprefix(f'{self.path}: ')}")
        except ValueError as error:
            said.append(f"the sound cannot be used: it {error}")
        found = gatherer.result() if gatherer else SoundGatherer(48_000).result()
        return found, rate_hz, channels

    def _frames(self, said: list[str]) -> Iterator[AudioFrame]:
        """Yield the decoded packets but for damaged ones; raise LogError if unreadable."""
        from av.error import FFmpegError

        damaged = 0
        with opened_media(self.path, self.formats, "sound") as container:
            stream = container.streams.audio[self.index]
            # Samples of a decoded packet: the largest of any lossless codec.
            stream.codec_context.options = {"max_samples": "262144"}
            for packet in container.demux(stream):
                try:
                    yield from packet.decode()
                except (FFmpegError, ValueError, OverflowError, MemoryError):
                    damaged += 1
                    if damaged > 1000:  # the track is given up
                        break
        if damaged:
            said.append(f"{damaged} damaged packets of sound were left out")


class PacketTimes:
    """Collector of the times of a sound track's packets."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream
        self._base_s = float(stream.time_base or 0)
        self._begins_s: list[float] = []
        self._ends_s = 0.0

    def add(self, packet: Any) -> None:
        """Record the time of a packet."""
        is_heard = packet.size and not packet.is_discard
        if not is_heard or len(self._begins_s) >= _MAX_PACKETS:
            return
        begin_s = self._ends_s if packet.pts is None else packet.pts * self._base_s
        self._begins_s.append(begin_s)
        self._ends_s = max(self._ends_s, begin_s + (packet.duration or 0) * self._base_s)

    @property
    def is_enough(self) -> bool:
        """Whether more was collected than is used."""
        return len(self._begins_s) >= _MAX_PACKETS or (
            bool(self._begins_s) and self._ends_s - self._begins_s[0] > MAX_S
        )

    def track(self, path: Path, formats: str) -> SoundTrack:
        """Return the track with the packet times collected."""
        context = self.stream.codec_context
        begins_s = np.array(self._begins_s, np.float64)
        lasts_s = self._ends_s - float(begins_s[0]) if len(begins_s) else 0.0
        return SoundTrack(
            path=path,
            formats=formats,
            index=self.stream.container.streams.audio.index(self.stream),
            codec=context.codec.canonical_name,
            channels=context.layout.nb_channels,
            rate_hz=float(context.sample_rate or 0),
            packets_s=begins_s,
            lasts_s=lasts_s,
        )


def sound_stream(container: InputContainer) -> Any | None:
    """Return the first sound stream that can be decoded; None where there is none."""
    return next((one for one in container.streams.audio if one.codec_context is not None), None)


def film_streams(container: InputContainer) -> list[Any]:
    """Return the video streams; cover art of a sound file is none."""
    from av.stream import Disposition

    cover = Disposition.attached_pic
    return [stream for stream in container.streams.video if not stream.disposition & cover]


# ---- Sound of a video: on the clock of its frames, whether or not it was slowed down with them


def film_sound(
    track: SoundTrack, ticks: Sequence[int] | None, base_s: Fraction, clock: VideoClock
) -> SoundTrack:
    """Align a sound with its video's frames: their increasing `ticks`, of `base_s` [s] each."""
    log_s = (clock.stamps_ns - clock.stamps_ns[0]) * 1e-9
    if ticks is None:
        file_s = np.arange(len(log_s)) / (clock.stored_hz or 1.0)
        origin_s = 0.0
    else:
        file_s = (np.array(ticks, np.int64) - ticks[0]) * float(base_s)
        origin_s = float(ticks[0] * base_s)
    slow = float(log_s[-1] / file_s[-1]) if file_s[-1] > 0 and log_s[-1] > 0 else 1.0
    slow = 1.0 if abs(slow - 1) < 1e-6 else slow  # stamps are in whole ns
    warnings: list[str] = []
    sound_s, film_s = track.lasts_s, float(file_s[-1])
    is_slowed = max(slow, 1 / slow) >= 1.05  # less is not called slow motion
    is_long = min(sound_s, film_s, film_s * slow) >= 0.2  # enough to compare them
    # As long as the filming, rather than as the film: the sound kept its speed.
    is_filmed = is_long and abs(math.log(sound_s / (film_s * slow))) < abs(
        math.log(sound_s / film_s)
    )
    if is_slowed and is_filmed:
        warnings.append(
            f"the film was slowed down {1 / slow:.3g} times, its sound was not: it lasts "
            f"{sound_s:.2f} s, the film {film_s:.2f} s"
        )
        slow = 1.0
    elif is_slowed:
        warnings.append(f"the sound was slowed down {1 / slow:.3g} times with its film")
    off_s = float(np.abs(log_s - file_s * slow).max()) if not warnings or slow != 1.0 else 0.0
    if off_s > 0.005:
        warnings.append(
            f"the pictures' stamps are up to {off_s * 1e3:.0f} ms off the times of the sound"
        )
    start_ns = int(clock.stamps_ns[0])
    return replace(track, start_ns=start_ns, origin_s=origin_s, slow=slow, warnings=tuple(warnings))


# ---- Sound files, as voice recorders write them: .wav, .m4a, .mp3, .flac, .ogg

# How such files are mostly called; their contents tell what they are.
SUFFIXES = (".wav", ".m4a", ".mp3", ".flac", ".ogg", ".opus", ".aac", ".aiff", ".aif", ".caf")
_SAVE_AS_WAV = "save it as WAV of 16 bits a sample"  # the remedy for sound of a rare kind


def named_as_sound(path: Path) -> bool:
    """Return whether a file is named as sound, regardless of its content."""
    return path.suffix.lower() in SUFFIXES


def is_sound_alone(path: Path) -> bool:
    """Return whether a file holds sound and no video."""
    try:
        with opened_media(path, SOUNDS, "sound") as container:
            return sound_stream(container) is not None and not film_streams(container)
    except LogError:
        return False


def read_sound(path: Path, _options: ReadOptions = AS_IT_SAYS) -> Episode:
    """Read a sound file as an episode without signals, beginning at its creation time, or 0."""
    try:
        return _read(path)
    except LogError as error:
        if not named_as_sound(path) or error.remedy != COPY_AGAIN:
            raise
        what = f"{error.what}: it has {path.stat().st_size} bytes"
        raise LogError(what, f"copy it again, or {_SAVE_AS_WAV}") from error


def _read(path: Path) -> Episode:
    with opened_media(path, SOUNDS, "sound") as container:
        stream = sound_stream(container)
        if stream is None:
            raise LogError(f"{path}: holds no sound that can be decoded", _SAVE_AS_WAV)
        start_ns = creation_ns({**stream.metadata, **container.metadata}.get("creation_time", ""))
        times = PacketTimes(stream)
        for packet in container.demux(stream):
            times.add(packet)
            if times.is_enough:
                break
        track = replace(times.track(path, SOUNDS), start_ns=start_ns)
    if not len(track.packets_s):
        raise LogError(f"{path}: holds no sound", COPY_AGAIN)
    notes = {_ABOUT: _about(track.codec, track.rate_hz, track.channels)}
    info = EpisodeInfo(source=f"sound file {path.name}", notes=notes)
    return Episode(info, {}, (track.channel(),), open_sound=track.sound)


def _about(codec: str, file_hz: float, channels: int) -> str:
    width = {1: "mono", 2: "stereo"}.get(channels, f"{channels} channels")
    return f"{codec}, {file_hz:g} Hz, {width}"


# ---- Sound in a log: short blocks of PCM, and notes on what their messages cannot say

# Names of the notes.
_RATE, _FILE_RATE, _ABOUT = "sound_rate_hz", "sound_file_rate_hz", "sound"
WARNINGS_NOTE = "sound_warnings"
BLOCK_S = 0.1  # of the log's clock, in each message


def sound_notes_of(sound: Sound) -> dict[str, str]:
    """Return the notes on a sound that is written to a log."""
    about = _about(sound.codec, sound.file_rate_hz, sound.channels)
    notes = rate_notes(about, sound.rate_hz, sound.file_rate_hz)
    return notes | ({WARNINGS_NOTE: "; ".join(sound.warnings)} if sound.warnings else {})


def rate_notes(about: str, rate_hz: float, told_hz: float) -> dict[str, str]:
    """Return the notes on what a sound is, and its rate on the log's clock and as it says."""
    return {_ABOUT: about, _RATE: repr(float(rate_hz)), _FILE_RATE: repr(float(told_hz))}


def why_not_kept(sound: Sound) -> str:
    """Return why a sound cannot be written to a log; "" where it can."""
    low_hz, high_hz = RATES_HZ
    if not len(sound.samples):
        return "; ".join(sound.warnings) or "it holds no sound"
    if not low_hz <= sound.rate_hz <= high_hz:
        return f"{sound.rate_hz:.6g} samples a second on the log's clock are no sound's"
    return ""


def noted_rates(notes: Mapping[str, str]) -> tuple[float, float]:
    """Return the noted rates of a log's sound, on its clock and in its file; 0 if unknown."""
    rates = [0.0, 0.0]
    for at, name in enumerate((_RATE, _FILE_RATE)):
        with suppress(ValueError):
            rate_hz = float(notes.get(name, ""))
            rates[at] = rate_hz if 0 < rate_hz < math.inf else 0.0
    return rates[0], rates[1]


def sound_blocks(sound: Sound) -> Iterator[tuple[int, NDArray[np.int16]]]:
    """Yield the blocks of a sound, shape (N, 1), with stamps [ns]; none before the epoch."""
    step = max(1, round(BLOCK_S * sound.rate_hz))
    begin = max(0, int(np.ceil(-sound.start_ns * 1e-9 * sound.rate_hz)))
    for first in range(begin, len(sound.samples), step):
        stamp_ns = sound.start_ns + round(first / sound.rate_hz * 1e9)
        yield max(stamp_ns, 0), as_pcm(sound.samples[first : first + step])[:, None]


def as_pcm(samples: NDArray[np.float32]) -> NDArray[np.int16]:
    """Convert samples of full scale 1 to 16-bit PCM of the same shape."""
    full = _FULL_SCALE["i2"]
    return np.clip(np.round(samples * full), -full, full - 1).astype(np.int16)
