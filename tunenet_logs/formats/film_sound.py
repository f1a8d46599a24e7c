"""Align a video's sound with its frames, whether or not it was slowed down with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from tunenet_logs.episode import Channel
from tunenet_logs.formats.sound_track import SoundTrack
from tunenet_logs.formats.video_clock import VideoClock
from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.sound import Sound

_SAME_RATE = 1.05  # a film that is slowed down less is not called slow motion
_SHORT_S = 0.2  # of a film or a sound that is too short to compare the two
_ROUNDING = 1e-6  # of stamps in whole ns, over a film
# Between a picture's stamp and where the sound beside it lies, from which on it is told.
_UNEVEN_S = 0.005


@dataclass(frozen=True, eq=False)
class FilmSound:
    """Sound of a video on the clock of its frames.

    Attributes:
        track: in its file.
        start_ns: stamp of the first frame shown.
        origin_s: time of that frame in the file [s].
        slow: seconds of the log's clock in one of the file's: below 1 for sound that was slowed
            down with its video, 1 for sound that was not.
        warnings: what is doubtful, in words.
    """

    track: SoundTrack
    start_ns: int
    origin_s: float
    slow: float
    warnings: tuple[str, ...]

    def channel(self) -> Channel:
        """Return the sound as a channel of the video, each packet a message."""
        after_s = (self.track.packets_s - self.origin_s) * self.slow
        return Channel(
            topic=AUDIO_TOPIC,
            type_name=self.track.codec,
            encoding="audio",
            log_ns=self.start_ns + np.round(after_s * 1e9).astype(np.int64),
            sounds=True,
        )

    def sound(self, _topic: str = AUDIO_TOPIC) -> Sound:
        """Decode the samples."""
        return self.track.sound(self.start_ns, self.origin_s, self.slow, self.warnings)


def film_sound(
    track: SoundTrack, ticks: Sequence[int] | None, base_s: Fraction, clock: VideoClock
) -> FilmSound:
    """Align a sound with its video's frames.

    Sound as long as the video was slowed down with it; sound as long as the filming was not.

    Args:
        track: the sound.
        ticks: of the frames shown, increasing; None where they have no times.
        base_s: one tick [s].
        clock: of the frames.
    """
    log_s = (clock.stamps_ns - clock.stamps_ns[0]) * 1e-9
    if ticks is None:
        file_s = np.arange(len(log_s)) / (clock.stored_hz or 1.0)
        origin_s = 0.0
    else:
        file_s = (np.array(ticks, np.int64) - ticks[0]) * float(base_s)
        origin_s = float(ticks[0] * base_s)
    slow = float(log_s[-1] / file_s[-1]) if file_s[-1] > 0 and log_s[-1] > 0 else 1.0
    slow = 1.0 if abs(slow - 1) < _ROUNDING else slow
    warnings: list[str] = []
    if max(slow, 1 / slow) >= _SAME_RATE and _is_true(track.lasts_s, float(file_s[-1]), slow):
        warnings.append(
            f"the film was slowed down {1 / slow:.3g} times, its sound was not: it lasts "
            f"{track.lasts_s:.2f} s, the film {file_s[-1]:.2f} s"
        )
        slow = 1.0
    elif max(slow, 1 / slow) >= _SAME_RATE:
        warnings.append(f"the sound was slowed down {1 / slow:.3g} times with its film")
    off_s = float(np.abs(log_s - file_s * slow).max()) if not warnings or slow != 1.0 else 0.0
    if off_s > _UNEVEN_S:
        warnings.append(
            f"the pictures' stamps are up to {off_s * 1e3:.0f} ms off the times of the sound"
        )
    return FilmSound(track, int(clock.stamps_ns[0]), origin_s, slow, tuple(warnings))


def _is_true(sound_s: float, film_s: float, slow: float) -> bool:
    """Return whether a sound lasts as long as the filming, rather than as the video."""
    if min(sound_s, film_s, film_s * slow) < _SHORT_S:
        return False
    return abs(math.log(sound_s / (film_s * slow))) < abs(math.log(sound_s / film_s))
