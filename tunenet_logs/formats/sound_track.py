"""Sound track of a file: packet times, and samples decoded on demand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import LogError
from tunenet_logs.formats.gathered_sound import MAX_S, GatheredSound, SoundGatherer
from tunenet_logs.formats.media_file import opened_media
from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.sound import Sound

if TYPE_CHECKING:
    from av import AudioFrame
    from av.container import InputContainer

_MAX_PACKETS = 250_000  # of sound, that are listed: an hour and a half of AAC
# Samples that a packet may be decoded to: what the largest of lossless codecs has.
_MAX_FRAME = 262_144

_MAX_DAMAGED = 1000  # packets that cannot be decoded, after which a track is given up


@dataclass(frozen=True, eq=False)
class SoundTrack:
    """Sound track of a file, as the file describes it.

    Attributes:
        path: of the file.
        formats: allowed ones; see `opened_media`.
        index: of the stream among those of sound.
        codec: as FFmpeg calls it.
        channels: stated by the file.
        rate_hz: stated by the file, which need not be what its decoder gives.
        packets_s: begin of each packet, on the file's clock, shape (P,) [s].
        lasts_s: to the end of the last packet [s].
    """

    path: Path
    formats: str
    index: int
    codec: str
    channels: int
    rate_hz: float
    packets_s: NDArray[np.float64]
    lasts_s: float

    def sound(
        self,
        start_ns: int,
        origin_s: float | None = None,
        slow: float = 1.0,
        warnings: tuple[str, ...] = (),
    ) -> Sound:
        """Decode the samples; a damaged track ends at the damage.

        Args:
            start_ns: the log's stamp of the file's time `origin_s`.
            origin_s: see there [s]; the first sample's if None.
            slow: seconds of the log's clock in one of the file's.
            warnings: known before.
        """
        said: list[str] = []
        gathered, file_hz, channels = self._decoded(said)
        begins_s = gathered.start_s if len(gathered.samples) else origin_s
        after_s = 0.0 if origin_s is None or begins_s is None else (begins_s - origin_s) * slow
        return Sound(
            name=AUDIO_TOPIC,
            start_ns=start_ns + round(after_s * 1e9),
            rate_hz=gathered.rate_hz / slow,
            samples=gathered.samples,
            file_rate_hz=file_hz,
            channels=channels,
            codec=self.codec,
            warnings=(*warnings, *gathered.warnings, *said),
        )

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
                gatherer.add(_piece(frame), at_s)
                if gatherer.is_full:
                    break
        except LogError as error:
            said.append(f"the sound is damaged: {error.what.removeprefix(f'{self.path}: ')}")
        except ValueError as error:
            said.append(f"the sound cannot be used: it {error}")
        found = gatherer.result() if gatherer else _nothing()
        return found, rate_hz, channels

    def _frames(self, said: list[str]) -> Iterator[AudioFrame]:
        """Yield the decoded packets but for damaged ones; raise LogError if unreadable."""
        from av.error import FFmpegError

        damaged = 0
        with opened_media(self.path, self.formats, "sound") as container:
            stream = container.streams.audio[self.index]
            stream.codec_context.options = {"max_samples": str(_MAX_FRAME)}
            for packet in container.demux(stream):
                try:
                    yield from packet.decode()
                except (FFmpegError, ValueError, OverflowError, MemoryError):
                    damaged += 1
                    if damaged > _MAX_DAMAGED:
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
    for stream in container.streams.audio:
        if stream.codec_context is not None:
            return stream
    return None


def _nothing() -> GatheredSound:
    return SoundGatherer(48_000).result()


def _piece(frame: AudioFrame) -> NDArray[Any]:
    """Return a frame's samples, shape (N, channels)."""
    values = frame.to_ndarray()
    if frame.format.is_planar:
        return values.T
    return values.reshape(frame.samples, -1)
