"""Draw a bounce at random, as a phone hears it, with the truth behind it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from analysis.evaluation.sound.backgrounds import BACKGROUNDS, Background, background_sound
from analysis.evaluation.sound.bounces import BounceHistory, BounceOrder, bounced
from analysis.evaluation.sound.impact_sound import add_impacts
from analysis.evaluation.sound.loudness import impact_ratio
from analysis.evaluation.sound.room import SoundPhone, SoundRoom, draw_phone, draw_room
from analysis.evaluation.sound.sound_file import through_aac, write_sound
from analysis.evaluation.sound.sounding_balls import (
    SOUNDING_BALLS,
    SOUNDING_TABLES,
    ImpactVoice,
    SampledBall,
    draw_ball,
    draw_voice,
)
from tunenet_logs.arrays import Array
from tunenet_logs.sound import Sound

Codec = Literal["pcm", "aac"]

RESTITUTIONS = (0.5, 0.95)
SLOPES = (0.0, 0.15)
HEIGHTS_M = (0.3, 1.5)
SNRS_DB = (20.0, 40.0)  # drawn evenly, where no ratio is asked for
MIN_IMPACTS = 5
MAX_IMPACTS = 14  # of the impacts that are loud enough, those that are recorded
FAINTEST = 10**-1.5  # an impact counts as audible down to 30 dB below the loudest
_SEEDS = 1_000_000  # added to a seed: negative ones are for choosing, positive ones for reporting
RATES_HZ = (44_100, 48_000)
SPEED_OF_SOUND_M_S = 343.0
_LOUDNESS = (1.2, 1.8)
_LEAD_S = (0.2, 1.2)
_DISTANCE_M = (0.15, 1.5)
_WALK_M_S = 0.03  # standard deviation of the speed by which the ball comes nearer or goes away
_MAX_S = 10.0


@dataclass(frozen=True, eq=False)
class SoundScene:
    """Bounce and where it is heard, before any background.

    Attributes:
        ball: what bounces.
        table: on what, its name.
        history: the bounce.
        voice: how they sound together.
        room: around them.
        phone: that records.
        audible: how many impacts are recorded and at most 30 dB below the loudest.
        rate_hz: of the samples.
        release_s: when the ball is let go, after the first sample.
        lasts_s: length of the recording.
        distance_m: from ball to microphone at the release.
        walk_m_s: by which that grows.
        seed: of what differs from impact to impact.
    """

    ball: SampledBall
    table: str
    history: BounceHistory
    voice: ImpactVoice
    room: SoundRoom
    phone: SoundPhone
    audible: int
    rate_hz: int
    release_s: float
    lasts_s: float
    distance_m: float
    walk_m_s: float
    seed: int

    @property
    def touches_s(self) -> Array:
        """Start of each contact after the first sample, to the end of the recording."""
        touches = self.release_s + self.history.touches_s
        return touches[touches < self.lasts_s]

    @property
    def impacts_s(self) -> Array:
        """Arrival of each contact's sound at the microphone, after the first sample."""
        away_m = self.distance_m + self.walk_m_s * (self.touches_s - self.release_s)
        return self.touches_s + np.maximum(away_m, 0.05) / SPEED_OF_SOUND_M_S

    def foreground(self) -> Array:
        """Synthesise the ball alone, in its room, by the phone's microphone, shape (N,)."""
        samples = np.zeros(int(self.lasts_s * self.rate_hz))
        impacts = zip(self.impacts_s, self.history.speeds_m_s, strict=False)
        add_impacts(samples, self.rate_hz, self.voice, impacts, np.random.default_rng(self.seed))
        return self.phone.band(self.room.heard(samples, self.rate_hz), self.rate_hz)


@dataclass(frozen=True, eq=False)
class SoundClip:
    """Recording and its truth.

    Attributes:
        samples: full scale 1, shape (N,).
        rate_hz: of them.
        scene: the bounce.
        background: what else is heard.
        snr_db: see `loudness.impact_ratio`.
        codec: that the samples went through.
    """

    samples: NDArray[np.float32]
    rate_hz: int
    scene: SoundScene
    background: Background
    snr_db: float
    codec: Codec

    @property
    def impacts_s(self) -> Array:
        """Arrival of each impact's sound, after the first sample, shape (N,)."""
        return self.scene.impacts_s

    @property
    def restitutions(self) -> Array:
        """Restitution of each impact, shape (N,)."""
        return self.scene.history.restitutions[: len(self.impacts_s)]

    @property
    def contacts_s(self) -> Array:
        """Duration of each contact, shape (N,)."""
        return self.scene.history.contacts_s[: len(self.impacts_s)]

    @property
    def ball_name(self) -> str:
        """Kind of ball."""
        return self.scene.ball.kind

    @property
    def drag_1_m(self) -> float:
        """Drag deceleration over speed squared."""
        return self.scene.history.order.drag_1_m

    @property
    def height_m(self) -> float:
        """Height of the fall."""
        return self.scene.history.order.height_m

    def write(self, path: Path) -> None:
        """Write as .wav or .m4a; the first as it is, the second encoded (once more, if it was)."""
        write_sound(self.samples, self.rate_hz, path)

    def sound(self, name: str = "/audio", start_ns: int = 0) -> Sound:
        """Return the sound in memory, as a reader gives it."""
        return Sound(
            name=name,
            start_ns=start_ns,
            rate_hz=float(self.rate_hz),
            samples=self.samples,
            file_rate_hz=float(self.rate_hz),
            codec="pcm_s16le" if self.codec == "pcm" else "aac",
        )


def draw_sound(
    seed: int,
    number: int,
    *,
    background: Background | None = None,
    snr_db: float | None = None,
    codec: Codec = "pcm",
    uneven: float = 0.0,
) -> SoundClip:
    """Draw clip `number` of a seed: the same bounce for any background, ratio and codec."""
    rng = np.random.default_rng([_SEEDS + seed, number, *b"bounce"])
    scene = draw_scene(rng, uneven=uneven)
    rng = np.random.default_rng([_SEEDS + seed, number, *b"background"])
    drawn = BACKGROUNDS[int(rng.integers(len(BACKGROUNDS)))]
    ratio_db = float(rng.uniform(*SNRS_DB))
    return recorded(
        scene,
        drawn if background is None else background,
        ratio_db if snr_db is None else snr_db,
        codec,
        int(rng.integers(2**31)),
    )


def recorded(
    scene: SoundScene, background: Background, snr_db: float, codec: Codec, seed: int
) -> SoundClip:
    """Mix a bounce with a background, and record it by the phone."""
    rate_hz, lasts_s = scene.rate_hz, scene.lasts_s
    foreground = scene.foreground()
    other = background_sound(background, lasts_s, rate_hz, np.random.default_rng(seed))
    other = scene.phone.band(other[: len(foreground)], rate_hz)
    heard = scene.impacts_s[: scene.audible]
    off_db = impact_ratio(foreground, other, rate_hz, heard) - snr_db
    mixed = foreground + 10 ** (off_db / 20) * other
    samples = scene.phone.recorded(mixed, rate_hz).astype(np.float32)
    if codec == "aac":
        samples = through_aac(samples, rate_hz)
    samples.flags.writeable = False
    return SoundClip(samples, rate_hz, scene, background, snr_db, codec)


def draw_scene(
    rng: np.random.Generator, lasts_s: float | None = None, uneven: float = 0.0
) -> SoundScene:
    """Draw any ball on any table that is heard at least five times.

    Args:
        rng: draws it.
        lasts_s: of the recording after the release; None to end it after 5 to 14 audible impacts.
        uneven: see `BounceOrder`.
    """
    while True:
        kind = SOUNDING_BALLS[int(rng.integers(len(SOUNDING_BALLS)))]
        table = SOUNDING_TABLES[int(rng.integers(len(SOUNDING_TABLES)))]
        ball = draw_ball(kind, rng)
        order = BounceOrder(
            float(rng.uniform(*HEIGHTS_M)),
            float(rng.uniform(*RESTITUTIONS)),
            float(rng.uniform(*SLOPES)),
            ball.drag_1_m,
            ball.contact_s,
            uneven,
            int(rng.integers(2**31)) if uneven else 0,
        )
        loudness = float(rng.uniform(*_LOUDNESS))
        history = bounced(order)
        loud = history.speeds_m_s**loudness
        audible = int(np.count_nonzero(loud > FAINTEST * loud[0]))
        release_s = float(rng.uniform(*_LEAD_S))
        most = int(rng.integers(MIN_IMPACTS, MAX_IMPACTS + 1))
        end_s = lasts_s or _end_s(history, min(audible, most), rng)
        audible = min(audible, int(np.count_nonzero(history.touches_s < end_s - 0.02)))
        scene = SoundScene(
            ball=ball,
            table=table.name,
            history=history,
            voice=draw_voice(kind, table, loudness, rng),
            room=draw_room(rng),
            phone=draw_phone(rng),
            audible=audible,
            rate_hz=int(rng.choice(RATES_HZ)),
            release_s=release_s,
            lasts_s=release_s + end_s,
            distance_m=float(rng.uniform(*_DISTANCE_M)),
            walk_m_s=float(rng.normal(0.0, _WALK_M_S)),
            seed=int(rng.integers(2**31)),
        )
        if audible >= MIN_IMPACTS:
            return scene


def _end_s(history: BounceHistory, count: int, rng: np.random.Generator) -> float:
    """Draw the end of the recording after the release: in the flight after so many impacts."""
    touches = history.touches_s
    if count < len(touches):
        flight = touches[count] - touches[count - 1]
        return float(min(touches[count - 1] + rng.uniform(0.4, 0.95) * flight, _MAX_S))
    return float(min(touches[-1] + rng.uniform(0.3, 1.0), _MAX_S))
