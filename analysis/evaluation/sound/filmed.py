"""Film and record the same bounce: a phone's mp4, its sound off by a constant."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from analysis.evaluation.clips.film import clip_frames, frame_seconds
from analysis.evaluation.clips.order import ClipOrder, draw_clip_of
from analysis.evaluation.clips.view import SIZES_PX
from analysis.evaluation.sound.backgrounds import BACKGROUNDS, Background
from analysis.evaluation.sound.clip import SoundClip, SoundScene, draw_scene, recorded
from analysis.evaluation.sound.negatives import NoBounce
from analysis.evaluation.sound.sound_file import AAC_BIT_S, add_sound
from analysis.evaluation.video.bouncing_ball import DroppedBall
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal

FILM_HZ = 30.0
OFFSET_S = 0.040  # sound is early or late by up to this
TRACK_NOISE_M = 0.002  # standard deviation of a coordinate of a track of positions
_SMALL_PX = SIZES_PX[:5]
_MAX_S = 4.0  # from the release to the end of a film
_EXPOSURES_S = (0.0, 0.008)
_TICKS_HZ = 90_000
_SEEDS = 3_000_000
_START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True, eq=False)
class FilmedSound:
    """Video with its sound.

    Attributes:
        order: the pictures.
        clip: the sound.
        offset_s: by which the sound is late, on the pictures' clock.
    """

    order: ClipOrder
    clip: SoundClip
    offset_s: float

    @property
    def restitution(self) -> float:
        """Restitution at the first impact."""
        return self.clip.scene.history.order.restitution

    def write(self, path: Path, *, with_sound: bool = True) -> None:
        """Write H.264 and AAC at 64 kbit/s, in an mp4."""
        import av

        width, height = (side // 2 * 2 for side in self.order.view.size_px)
        with av.open(str(path), "w") as container:
            options = {"crf": str(self.order.h264_factor), "preset": "ultrafast"}
            film: Any = container.add_stream("libx264", rate=30, options=options)
            film.width, film.height, film.pix_fmt = width, height, "yuv420p"
            film.codec_context.time_base = Fraction(1, _TICKS_HZ)
            film.thread_count = 1
            audio: Any = None
            if with_sound:
                audio = container.add_stream("aac", rate=self.clip.rate_hz)
                audio.bit_rate, audio.layout = AAC_BIT_S, "mono"
            seconds = frame_seconds(self.order) + self.order.held_s
            for picture, second in zip(clip_frames(self.order), seconds, strict=True):
                cut = np.ascontiguousarray(picture[:height, :width])
                frame = av.VideoFrame.from_ndarray(cut, format="rgb24")
                frame.pts, frame.time_base = round(second * _TICKS_HZ), Fraction(1, _TICKS_HZ)
                container.mux(film.encode(frame))
            container.mux(film.encode())
            if audio is not None:
                late = round(self.offset_s * self.clip.rate_hz)
                kept = self.clip.samples[max(-late, 0) :]
                add_sound(container, audio, kept, self.clip.rate_hz, max(late, 0))


def film_with_sound(
    seed: int,
    number: int,
    snr_db: float = 20.0,
    background: Background | None = None,
    uneven: float = 0.0,
) -> FilmedSound:
    """Draw video `number` of a seed, 30 fps, pictures up to 640 by 360."""
    rng = np.random.default_rng([_SEEDS + seed, number, *b"film"])
    scene = short_scene(rng, uneven)
    bounce = scene.history.order
    ball = DroppedBall(bounce.height_m, bounce.restitution, bounce.slope, bounce.drag_1_m)
    order = replace(
        draw_clip_of(ball, rng, _SMALL_PX),
        rate_hz=FILM_HZ,
        held_s=scene.release_s,
        length_s=scene.lasts_s - scene.release_s,
        exposure_s=float(rng.uniform(*_EXPOSURES_S)),
        person=None,
        as_log=False,
        heights_m=scene.history.heights_m,
    )
    return FilmedSound(order, *_heard(scene, snr_db, background, rng))


def short_scene(rng: np.random.Generator, uneven: float = 0.0) -> SoundScene:
    """Draw a bounce that is recorded for four seconds after the release at most."""
    scene = draw_scene(rng, uneven=uneven)
    if scene.lasts_s - scene.release_s <= _MAX_S:
        return scene
    end_s = scene.release_s + _MAX_S
    audible = int(np.count_nonzero(scene.impacts_s[: scene.audible] < end_s - 0.02))
    return replace(scene, lasts_s=end_s, audible=audible)


def _heard(
    scene: SoundScene, snr_db: float, background: Background | None, rng: np.random.Generator
) -> tuple[SoundClip, float]:
    drawn = BACKGROUNDS[int(rng.integers(len(BACKGROUNDS)))]
    seed = int(rng.integers(2**31))
    offset_s = float(rng.uniform(-OFFSET_S, OFFSET_S))
    return recorded(scene, background or drawn, snr_db, "pcm", seed), offset_s


@dataclass(frozen=True, eq=False)
class TrackedSound:
    """Track of the ball's positions at 30 Hz, and its sound.

    Attributes:
        clip: the sound.
        offset_s: by which the sound is late, on the positions' clock.
        seconds: of the positions, after the first, shape (T,).
        positions_m: z is up, shape (T, 3).
    """

    clip: SoundClip
    offset_s: float
    seconds: Array
    positions_m: Array

    @property
    def restitution(self) -> float:
        """Restitution at the first impact."""
        return self.clip.scene.history.order.restitution

    def episode(self) -> Episode:
        """Build the log in memory."""
        stamps_ns = _START_NS + np.round(self.seconds * 1e9).astype(np.int64)
        signal = Signal("/ball/pose", stamps_ns, self.positions_m, ("x", "y", "z"), "m")
        return with_sound(Episode(EpisodeInfo(), {signal.name: signal}), self.clip, self.offset_s)


def track_with_sound(
    seed: int,
    number: int,
    snr_db: float = 20.0,
    background: Background | None = None,
    uneven: float = 0.0,
) -> TrackedSound:
    """Draw track `number` of a seed; see `film_with_sound`."""
    rng = np.random.default_rng([_SEEDS + seed, number, *b"track"])
    scene = short_scene(rng, uneven)
    seconds = np.arange(0.0, scene.lasts_s, 1 / FILM_HZ)
    positions = np.tile([*rng.uniform(-1, 1, 2), rng.uniform(0, 1)], (len(seconds), 1))
    positions[:, 2] += scene.history.heights_m(seconds - scene.release_s)
    positions += rng.normal(0.0, TRACK_NOISE_M, positions.shape)
    clip, offset_s = _heard(scene, snr_db, background, rng)
    return TrackedSound(clip, offset_s, seconds, positions)


def with_sound(episode: Episode, heard: SoundClip | NoBounce, offset_s: float = 0.0) -> Episode:
    """Add a sound that begins `offset_s` after the episode's first sample or picture."""
    stamps = [int(signal.stamps_ns[0]) for signal in episode.signals.values()]
    stamps += [int(channel.log_ns[0]) for channel in episode.channels if len(channel.log_ns)]
    start_ns = min(stamps, default=_START_NS) + round(offset_s * 1e9)
    channel = Channel("/audio", "", "", np.array([start_ns]), sounds=True)
    return replace(
        episode,
        channels=(*episode.channels, channel),
        open_sound=lambda topic: heard.sound(topic, start_ns),
    )
