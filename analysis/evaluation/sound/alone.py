"""Tune from sound alone: bounces, by the product and by phyphox's way, and no bounces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.evaluation.sound.answers import SoundAnswer, answer_to
from analysis.evaluation.sound.backgrounds import Background
from analysis.evaluation.sound.bound import bound_sd, onset_errors_s
from analysis.evaluation.sound.clip import SoundClip, draw_sound
from analysis.evaluation.sound.filmed import with_sound
from analysis.evaluation.sound.negatives import NoBounce, draw_negative
from analysis.evaluation.sound.phyphox_way import best_reading
from tunenet_logs.episode import Episode, EpisodeInfo

SNRS_DB = (40.0, 30.0, 20.0, 10.0, 5.0)
TYPICAL_JITTER_S = 0.0002  # of an onset, where none was heard


@dataclass(frozen=True)
class AloneTrial:
    """Clip to be heard.

    Attributes:
        seed: of it.
        number: likewise.
        snr_db: see `loudness.impact_ratio`.
        uneven: see `BounceOrder`.
    """

    seed: int
    number: int
    snr_db: float
    uneven: float = 0.0

    def clip(self) -> SoundClip:
        """Synthesise the clip: every second one through AAC."""
        codec = "aac" if self.number % 2 else "pcm"
        return draw_sound(
            self.seed, self.number, snr_db=self.snr_db, codec=codec, uneven=self.uneven
        )


@dataclass(frozen=True)
class AloneOutcome:
    """Result for a clip.

    Attributes:
        trial: which.
        ball: its kind.
        table: on what it bounced.
        background: what else was heard.
        impacts: how many were loud enough.
        truth: restitution at the second impact, by the ball's law.
        unnamed: the answer where the ball is not named.
        named: the answer where its size and mass are.
        jitter_s: rms error of the onsets that were used; NaN where there are fewer than three.
        bounds: least standard deviation of a value from onsets with this jitter, the ball not named
            and named; see `bound.bound_sd`.
        phyphox: its value at the threshold that is best for this clip; NaN where no threshold hears
            the first three impacts first.
        phyphox_hears: whether a threshold hears the first five impacts first.
    """

    trial: AloneTrial
    ball: str
    table: str
    background: Background
    impacts: int
    truth: float
    unnamed: SoundAnswer
    named: SoundAnswer
    jitter_s: float
    bounds: tuple[float, float]
    phyphox: float
    phyphox_hears: bool


def alone_outcome(trial: AloneTrial) -> AloneOutcome:
    """Tune a clip, with the ball named and not, and read it as phyphox does."""
    clip = trial.clip()
    scene = clip.scene
    episode = sound_alone(clip)
    unnamed, times_s = answer_to(episode)
    named, _ = answer_to(episode, scene.ball.told)
    off = onset_errors_s(times_s, clip.impacts_s)
    jitter_s = float(np.sqrt(np.mean(off**2))) if len(off) > 2 else np.nan
    usual_s = TYPICAL_JITTER_S if not np.isfinite(jitter_s) else max(jitter_s, 1e-5)
    heard = scene.audible
    bounds = tuple(bound_sd(scene.history, heard, usual_s, named=one) for one in (False, True))
    best = best_reading(clip)
    return AloneOutcome(
        trial=trial,
        ball=clip.ball_name,
        table=scene.table,
        background=clip.background,
        impacts=scene.audible,
        truth=float(scene.history.by_law[1]),
        unnamed=unnamed,
        named=named,
        jitter_s=jitter_s,
        bounds=(bounds[0], bounds[1]),
        phyphox=np.nan if best is None else float(best.restitutions[0]),
        phyphox_hears=best_reading(clip, 5) is not None,
    )


def sound_alone(heard: SoundClip | NoBounce) -> Episode:
    """Build a log that holds this sound and nothing else."""
    return with_sound(Episode(EpisodeInfo(), {}), heard)


@dataclass(frozen=True)
class NegativeOutcome:
    """Result for a sound that is no bounce.

    Attributes:
        seed: of it.
        number: likewise.
        kind: of what is heard.
        answer: of the product.
    """

    seed: int
    number: int
    kind: str
    answer: SoundAnswer


def negative_outcome(asked: tuple[int, int]) -> NegativeOutcome:
    """Tune the negative of a seed and a number."""
    heard = draw_negative(*asked)
    return NegativeOutcome(*asked, heard.kind, answer_to(sound_alone(heard))[0])
