"""Tune videos and tracks with sound beside them: their own, another's, or none."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from analysis.evaluation.sound.alone import sound_alone
from analysis.evaluation.sound.answers import SoundAnswer, answer_to, without_sound
from analysis.evaluation.sound.backgrounds import Background, background_sound
from analysis.evaluation.sound.filmed import film_with_sound, track_with_sound, with_sound
from analysis.evaluation.sound.negatives import NoBounce
from analysis.evaluation.sound.sound_file import through_aac
from tunenet_logs.episode import Episode
from tunenet_logs.reader import read_episode

FILM_SNR_DB = 20.0
UNRELATED = ("noise", "speech", "music", "silence")
_RATE_HZ = 48_000
_SEEDS = 4_000_000


@dataclass(frozen=True)
class BesideTrial:
    """One video or track.

    Attributes:
        kind: "film" or "track".
        seed: of it.
        number: likewise.
        unrelated: sounds of `UNRELATED` that are put beside it in turn.
        uneven: of a film, see `BounceOrder`.
    """

    kind: str
    seed: int
    number: int
    unrelated: tuple[str, ...] = ()
    uneven: float = 0.0


@dataclass(frozen=True)
class BesideOutcome:
    """Result of a trial.

    Attributes:
        trial: which.
        background: behind its own sound.
        truth: restitution at the first impact.
        deaf: the answer without sound.
        heard: with its own.
        unrelated: with each of the trial's unrelated sounds.
        alone: verdicts on these sounds alone.
    """

    trial: BesideTrial
    background: str
    truth: float
    deaf: SoundAnswer
    heard: SoundAnswer
    unrelated: tuple[SoundAnswer, ...]
    alone: tuple[str, ...]


def beside_outcome(trial: BesideTrial) -> BesideOutcome:
    """Tune a trial with each sound, each from a log that was opened afresh."""
    if trial.kind == "track":
        track = track_with_sound(trial.seed, trial.number, FILM_SNR_DB)
        clip = track.clip
        return _answered(
            trial, clip.background, track.restitution, clip.scene.lasts_s, track.episode
        )
    film = film_with_sound(trial.seed, trial.number, FILM_SNR_DB, uneven=trial.uneven)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        film.write(path)
        return _answered(
            trial,
            film.clip.background,
            film.restitution,
            film.clip.scene.lasts_s,
            lambda: read_episode(path),
        )


def _answered(
    trial: BesideTrial,
    background: str,
    truth: float,
    lasts_s: float,
    opened: Callable[[], Episode],
) -> BesideOutcome:
    deaf, _ = answer_to(without_sound(opened()))
    heard, _ = answer_to(opened())
    others = [unrelated_sound(what, lasts_s, trial.seed, trial.number) for what in trial.unrelated]
    return BesideOutcome(
        trial=trial,
        background=background,
        truth=truth,
        deaf=deaf,
        heard=heard,
        unrelated=tuple(
            answer_to(with_sound(without_sound(opened()), other))[0] for other in others
        ),
        alone=tuple(answer_to(sound_alone(other))[0].verdict for other in others),
    )


def unrelated_sound(what: str, lasts_s: float, seed: int, number: int) -> NoBounce:
    """Synthesise noise, speech, music or silence as long as a video, through AAC."""
    rng = np.random.default_rng([_SEEDS + seed, number, *what.encode()])
    samples = np.zeros(int(lasts_s * _RATE_HZ))
    if what != "silence":
        made = background_sound(cast("Background", what), lasts_s, _RATE_HZ, rng)
        made = made[: len(samples)]
        samples[: len(made)] = rng.uniform(0.1, 0.9) * made / np.max(np.abs(made))
    heard = NoBounce(what, samples.astype(np.float32), _RATE_HZ, "pcm")
    return replace(heard, samples=through_aac(heard.samples, _RATE_HZ), codec="aac")
