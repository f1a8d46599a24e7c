"""Tune bounces by their sound, alone and beside pictures, and sounds that are no bounce.

Answers stand beside the truth, the Cramér-Rao bound of onsets with their jitter, and what a user
does today: the "(In)elastic collision" of phyphox.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.study import csv_text, json_text, seeds_in_words, table_line
from tunenet_logs.analysis.evaluation.worlds.audio import (
    Background,
    NoBounce,
    SoundClip,
    background_sound,
    draw_negative,
    draw_sound,
    film_with_sound,
    through_aac,
    track_with_sound,
    with_sound,
)
from tunenet_logs.analysis.evaluation.worlds.ball import BounceHistory, BounceOrder, bounced
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.record import Record
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.known import UNKNOWN_BALL, Ball
from tunenet_logs.terminal import Progress

# ---- Answers to a sound, alone or beside pictures.


@dataclass(frozen=True)
class SoundAnswer:
    """Answer of a tuning; NaN where there is none."""

    verdict: str  # "ok", "suspect" or "rejected"
    reason: str  # why it is not "ok"; "" where it is
    value: float  # restitution, at the first impact that the log determines
    low: float  # lower end of its 95 % interval
    high: float  # upper end
    slope: float  # of the restitution's fall with speed
    # when each impact was, after the log's first sample, and its restitution
    rebounds: tuple[tuple[float, float], ...]
    seconds: float  # of the processor

    @property
    def is_answered(self) -> bool:
        """Whether a user gets a value that counts: with its interval, or "ok"."""
        return bool(np.isfinite(self.value)) and (self.verdict == "ok" or np.isfinite(self.low))

    @property
    def width(self) -> float:
        """Width of the interval."""
        return self.high - self.low

    def covers(self, truth: float) -> bool:
        """Check whether the interval holds the truth."""
        return self.low <= truth <= self.high


def answer_to(episode: Episode, ball: Ball = UNKNOWN_BALL) -> tuple[SoundAnswer, Array]:
    """Tune an episode; return the answer, and the impact times heard [s], shape (N,)."""
    began_s = time.process_time()
    tuning = tune_episode(episode, TuneOptions(ball=ball))
    seconds = time.process_time() - began_s
    return answer_of(record_of(tuning), seconds), _heard_s(tuning)


def answer_of(record: Record, seconds: float) -> SoundAnswer:
    """Extract the answer from a record."""
    found = record.estimate("restitution")
    slope = record.estimate("restitution_slope")
    low, high = np.nan, np.nan
    if found is not None and found.interval95 is not None:
        low, high = np.ravel(found.interval95).tolist()[:2]
    return SoundAnswer(
        verdict=record.verdict,
        reason=record.reason or "",
        value=np.nan if found is None else float(np.ravel(found.value)[0]),
        low=low,
        high=high,
        slope=np.nan if slope is None else float(np.ravel(slope.value)[0]),
        rebounds=tuple((one.impact_s, one.restitution) for one in record.rebounds),
        seconds=seconds,
    )


def _heard_s(tuning: Tuning) -> Array:
    """Return the impact times that a sound alone was tuned by; none of a video."""
    times = getattr(tuning.detection, "times_s", None)
    return np.zeros(0) if times is None else np.asarray(times, dtype=np.float64)


def without_sound(episode: Episode) -> Episode:
    """Return the episode without sound."""
    channels = tuple(channel for channel in episode.channels if not channel.sounds)
    return replace(episode, channels=channels, open_sound=None)


# ---- Cramér-Rao bound: how well onsets of a known jitter tell the second impact's restitution.


# Steps of differences: of slope and restitution as they are, of the others in their logarithm.
_STEPS = {"height_m": 1e-3, "restitution": 1e-4, "slope": 1e-3, "drag_1_m": 1e-2, "contact_s": 2e-2}

# Prior standard deviations, in the same measure; of the drag where the ball is not named, and is.
_PRIORS = {"height_m": 0.7, "restitution": 0.3, "slope": 0.09, "contact_s": 1.0}
_LOG_DRAG_SD, _KNOWN_DRAG_SD = 1.1, 0.1

# Mean absolute error over standard deviation, of a normal distribution.
MEAN_OF_SD = float(np.sqrt(2 / np.pi))


def bound_sd(history: BounceHistory, count: int, jitter_s: float, *, named: bool) -> float:
    """Return the Cramér-Rao bound on the second impact's restitution (standard deviation).

    The Cramér-Rao bound with priors: unknown are when the recording began, the fall, restitution,
    slope, drag, and how long a contact lasts.

    Args:
        history: the bounce.
        count: how many of its impacts are heard.
        jitter_s: standard deviation of an onset.
        named: whether the ball is, so that its drag is known to a tenth.
    """
    count = min(count, len(history.touches_s))
    rows, gains, priors = [np.ones(count)], [0.0], [0.0]
    for name, step in _STEPS.items():
        ahead, behind = (_bounce_moved(history.order, name, way * step) for way in (1, -1))
        shared = min(count, len(ahead.touches_s), len(behind.touches_s))
        change = np.zeros(count)
        change[:shared] = (ahead.touches_s[:shared] - behind.touches_s[:shared]) / (2 * step)
        rows.append(change)
        gains.append((ahead.restitutions[1] - behind.restitutions[1]) / (2 * step))
        drag_sd = _KNOWN_DRAG_SD if named else _LOG_DRAG_SD
        priors.append(_PRIORS.get(name, drag_sd) ** -2)
    jacobian, gain = np.column_stack(rows) / jitter_s, np.array(gains)
    information = jacobian.T @ jacobian + np.diag(priors)
    return float(np.sqrt(gain @ np.linalg.solve(information, gain)))


def _bounce_moved(order: BounceOrder, name: str, step: float) -> BounceHistory:
    value = getattr(order, name)
    moved = value + step if name in ("restitution", "slope") else value * np.exp(step)
    return bounced(replace(order, **{name: float(moved)}))


def onset_errors_s(times_s: Array, impacts_s: Array, within_s: float = 0.005) -> Array:
    """Return the errors of onsets that belong to an impact, less their median, shape (M,).

    The clocks may differ: the constant between the two is that with which most onsets are an
    impact's.

    Args:
        times_s: of the onsets, shape (N,).
        impacts_s: when the sound of each impact begins, shape (K,).
        within_s: of it counts as the impact's.
    """
    best = np.zeros(0)
    for offset in (times_s[:, None] - impacts_s).ravel().tolist():
        off = times_s[:, None] - impacts_s - offset
        nearest = off[np.arange(len(off)), np.abs(off).argmin(axis=1)]
        own = nearest[np.abs(nearest) < within_s]
        if len(own) > len(best):
            best = own - np.median(own)
    return best


# ---- phyphox's "(In)elastic collision" 1.4: an impact keeps the squared ratio of two flights.
# An event is the first sample over a threshold, at least a minimum delay after the last one. The
# first six give five flights. There is no air in it and no doubt.


TYPICAL_THRESHOLD = 0.1  # of full scale, unless a user sets another
DELAY_S = 0.1  # likewise
MAX_EVENTS = 6

# Thresholds that are tried: so many, evenly in the logarithm, from this fraction of the loudest
# sample on.
_THRESHOLDS, _MIN_THRESHOLD = 60, 0.003

# An event is an impact's if it is so much after or before the beginning of its sound.
_LATE_S, _EARLY_S = 0.02, 0.001


@dataclass(frozen=True, eq=False)
class PhyphoxReading:
    """Reading of the app at one threshold."""

    threshold: float  # of full scale
    events_s: Array  # at most six, after the first sample, shape (N,)
    # how many of them, from the first on, are the ball's first impacts, one after another
    right: int

    @property
    def restitutions(self) -> Array:
        """Root of the kept energy at the second event, the third, ..., shape (N - 2,)."""
        flights = np.diff(self.events_s)
        return flights[1:] / flights[:-1]


def events_over(
    samples: NDArray[np.float32], rate_hz: float, threshold: float, delay_s: float = DELAY_S
) -> Array:
    """Return when samples first exceed a threshold [s], shape (N,), six at most."""
    over = np.flatnonzero(np.abs(samples) > threshold) / rate_hz
    events: list[float] = []
    at = 0
    while at < len(over) and len(events) < MAX_EVENTS:
        events.append(float(over[at]))
        at = int(np.searchsorted(over, over[at] + delay_s))
    return np.array(events)


def reading(clip: SoundClip, threshold: float) -> PhyphoxReading:
    """Read a clip as the app does."""
    events = events_over(clip.samples, clip.rate_hz, threshold)
    right = 0
    for event, impact in zip(events, clip.impacts_s, strict=False):
        if not -_EARLY_S <= event - impact <= _LATE_S:
            break
        right += 1
    return PhyphoxReading(threshold, events, right)


def best_reading(clip: SoundClip, fewest_events: int = 3) -> PhyphoxReading | None:
    """Read a clip at the threshold nearest to the true restitution; None without any.

    Only thresholds count at which the first events are the ball's first impacts: a user who hears
    and sees the ball could know that.

    Args:
        clip: with its truth.
        fewest_events: that must be the first impacts; 3 give one restitution.
    """
    loudest = float(np.max(np.abs(clip.samples)))
    thresholds = loudest * np.geomspace(_MIN_THRESHOLD, 0.99, _THRESHOLDS)
    tried = [reading(clip, threshold) for threshold in (*thresholds.tolist(), TYPICAL_THRESHOLD)]
    good = [one for one in tried if one.right >= fewest_events]
    truth = clip.restitutions[1]
    return min(good, key=lambda one: abs(one.restitutions[0] - truth), default=None)


# ---- Sound alone: bounces, by the product and by phyphox's way, and sounds that are no bounce.


SNRS_DB = (40.0, 30.0, 20.0, 10.0, 5.0)
TYPICAL_JITTER_S = 0.0002  # of an onset, where none was heard


@dataclass(frozen=True)
class AloneTrial:
    """Clip to be heard."""

    seed: int  # of it
    number: int  # likewise
    snr_db: float  # see `impact_ratio`
    uneven: float = 0.0  # see `BounceOrder`

    def clip(self) -> SoundClip:
        """Synthesise the clip: every second one through AAC."""
        codec = "aac" if self.number % 2 else "pcm"
        return draw_sound(
            self.seed, self.number, snr_db=self.snr_db, codec=codec, uneven=self.uneven
        )


@dataclass(frozen=True)
class AloneOutcome:
    """Result for a clip."""

    trial: AloneTrial  # which
    ball: str  # its kind
    table: str  # on what it bounced
    background: Background  # what else was heard
    impacts: int  # how many were loud enough
    truth: float  # restitution at the second impact, by the ball's law
    unnamed: SoundAnswer  # the answer where the ball is not named
    named: SoundAnswer  # the answer where its size and mass are
    jitter_s: float  # rms error of the onsets that were used; NaN where there are fewer than three
    # least standard deviation of a value from onsets with this jitter, the ball not named and
    # named; see `bound_sd`
    bounds: tuple[float, float]
    # its value at the threshold that is best for this clip; NaN where no threshold hears the first
    # three impacts first
    phyphox: float
    phyphox_hears: bool  # whether a threshold hears the first five impacts first


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
    """Result for a sound that is no bounce."""

    seed: int  # of it
    number: int  # likewise
    kind: str  # of what is heard
    answer: SoundAnswer  # of the product


def negative_outcome(asked: tuple[int, int]) -> NegativeOutcome:
    """Tune the negative of a seed and a number."""
    heard = draw_negative(*asked)
    return NegativeOutcome(*asked, heard.kind, answer_to(sound_alone(heard))[0])


# ---- Sound beside pictures: videos and tracks with their own sound, another's, or none.


FILM_SNR_DB = 20.0
UNRELATED = ("noise", "speech", "music", "silence")
_RATE_HZ = 48_000
_UNRELATED_SEEDS = 4_000_000


@dataclass(frozen=True)
class BesideTrial:
    """One video or track."""

    kind: str  # "film" or "track"
    seed: int  # of it
    number: int  # likewise
    unrelated: tuple[str, ...] = ()  # sounds of `UNRELATED` that are put beside it in turn
    uneven: float = 0.0  # of a film, see `BounceOrder`


@dataclass(frozen=True)
class BesideOutcome:
    """Result of a trial."""

    trial: BesideTrial  # which
    background: str  # behind its own sound
    truth: float  # restitution at the first impact
    deaf: SoundAnswer  # the answer without sound
    heard: SoundAnswer  # with its own
    unrelated: tuple[SoundAnswer, ...]  # with each of the trial's unrelated sounds
    alone: tuple[str, ...]  # verdicts on these sounds alone


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
    rng = np.random.default_rng([_UNRELATED_SEEDS + seed, number, *what.encode()])
    samples = np.zeros(int(lasts_s * _RATE_HZ))
    if what != "silence":
        made = background_sound(cast("Background", what), lasts_s, _RATE_HZ, rng)
        made = made[: len(samples)]
        samples[: len(made)] = rng.uniform(0.1, 0.9) * made / np.max(np.abs(made))
    heard = NoBounce(what, samples.astype(np.float32), _RATE_HZ, "pcm")
    return replace(heard, samples=through_aac(heard.samples, _RATE_HZ), codec="aac")


# ---- Run: section by section.


# Signal-to-noise ratio [dB] of a good sound, or more; unevenness of a ball, see `BounceOrder`.
GOOD_DB, UNEVEN = 20.0, 0.003

SoundOutcome = AloneOutcome | NegativeOutcome | BesideOutcome


@dataclass(frozen=True)
class SoundOrder:
    """Settings of the experiment."""

    seeds: Sequence[int]  # each with its own sounds
    count: int  # for each seed: clips at a ratio, sounds that are no bounce, films, tracks
    sections: Sequence[str]  # of `study.SOUND_SECTIONS`
    jobs: int | None = None  # processes; None for all cores


def sound_sections(
    order: SoundOrder, progress: Progress
) -> Iterator[tuple[str, Sequence[SoundOutcome]]]:
    """Yield all results section by section; "alone" and "phyphox" share their clips."""
    clips: list[AloneOutcome] = []
    for section in order.sections:
        pairs = [(seed, number) for seed in order.seeds for number in range(order.count)]
        if section in ("alone", "phyphox"):
            if not clips:
                trials = [Piece(AloneTrial(*pair, snr)) for snr in SNRS_DB for pair in pairs]
                clips = parallel_map(alone_outcome, trials, order.jobs, progress, (section, "clip"))
            yield section, clips
        elif section == "uneven":
            trials = [Piece(AloneTrial(*pair, GOOD_DB, UNEVEN)) for pair in pairs]
            yield (
                section,
                parallel_map(alone_outcome, trials, order.jobs, progress, (section, "clip")),
            )
        elif section == "negatives":
            pieces = [Piece(pair) for pair in pairs]
            yield (
                section,
                parallel_map(negative_outcome, pieces, order.jobs, progress, (section, "sound")),
            )
        else:
            asked = [Piece(_beside_trial(section, *pair)) for pair in pairs]
            what = asked[0].item.kind if asked else section
            yield (
                section,
                parallel_map(beside_outcome, asked, order.jobs, progress, (section, what)),
            )


def _beside_trial(section: str, seed: int, number: int) -> BesideTrial:
    """Pair a video with one unrelated sound beside its own, or none; a track with all."""
    if section == "uneven-films":
        return BesideTrial("film", seed, number, uneven=UNEVEN)
    if section == "films":
        return BesideTrial("film", seed, number, (UNRELATED[number % len(UNRELATED)],))
    return BesideTrial("track", seed, number, UNRELATED)


# ---- JSON and CSV: one row for each answer.


# Of the CSV.
COLUMNS = (
    *("section", "seed", "number", "what", "background", "snr_db", "with", "truth"),
    *("verdict", "value", "low", "high", "slope", "seconds", "jitter_s", "bound", "reason"),
)

Found = Sequence[tuple[str, SoundOutcome]]  # outcomes with the names of their sections


def sound_json(found: Found, order: SoundOrder) -> str:
    """Serialise every answer."""
    head = {"experiment": "sound", "seeds": list(order.seeds), "count": order.count}
    return json_text({**head, "rows": list(_rows(found))})


def sound_csv(found: Found) -> str:
    """Format every answer as a table."""
    return csv_text(COLUMNS, [_flat(row) for row in _rows(found)])


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name in COLUMNS}


def _rows(found: Found) -> Iterator[dict[str, Any]]:
    for section, one in found:
        if isinstance(one, AloneOutcome):
            yield from _alone_rows(section, one)
        elif isinstance(one, NegativeOutcome):
            head = {"section": section, "seed": one.seed, "number": one.number, "what": one.kind}
            yield {**head, "with": "sound alone", **_answer(one.answer)}
        else:
            yield from _beside_rows(section, one)


def _alone_rows(section: str, one: AloneOutcome) -> Iterator[dict[str, Any]]:
    head = {
        "section": section,
        "seed": one.trial.seed,
        "number": one.trial.number,
        "what": f"{one.ball} on {one.table}",
        "background": one.background,
        "snr_db": one.trial.snr_db,
        "truth": one.truth,
        "impacts": one.impacts,
        "jitter_s": _finite(one.jitter_s),
    }
    for which, answer, bound in zip(
        ("ball not named", "ball named"), (one.unnamed, one.named), one.bounds, strict=True
    ):
        yield {**head, "with": which, "bound": _finite(bound), **_answer(answer)}
    yield {
        **head,
        "with": "phyphox",
        "value": _finite(one.phyphox),
        "hears_five": one.phyphox_hears,
    }


def _beside_rows(section: str, one: BesideOutcome) -> Iterator[dict[str, Any]]:
    head = {
        "section": section,
        "seed": one.trial.seed,
        "number": one.trial.number,
        "what": one.trial.kind,
        "background": one.background,
        "truth": one.truth,
    }
    yield {**head, "with": "no sound", **_answer(one.deaf)}
    yield {**head, "with": "its sound", **_answer(one.heard)}
    for what, answer, alone in zip(one.trial.unrelated, one.unrelated, one.alone, strict=True):
        yield {**head, "with": what, **_answer(answer)}
        yield {**head, "what": "sound alone", "with": what, "truth": None, "verdict": alone}


def _answer(answer: SoundAnswer) -> dict[str, Any]:
    return {
        "verdict": answer.verdict,
        "reason": answer.reason,
        "value": _finite(answer.value),
        "low": _finite(answer.low),
        "high": _finite(answer.high),
        "slope": _finite(answer.slope),
        "seconds": round(answer.seconds, 3),
        "rebounds": [list(one) for one in answer.rebounds],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


# ---- Tables for a terminal.


_VERDICTS = ("ok", "suspect", "rejected")


def sound_table(section: str, outcomes: Sequence[SoundOutcome], order: SoundOrder) -> str:
    """Tabulate one section, its head first."""
    makers: dict[str, Callable[[Sequence[SoundOutcome]], list[str]]] = {
        "alone": lambda found: _alone(cast("Sequence[AloneOutcome]", found)),
        "phyphox": lambda found: _phyphox(cast("Sequence[AloneOutcome]", found)),
        "negatives": lambda found: _negatives(cast("Sequence[NegativeOutcome]", found)),
        "uneven": lambda found: _alone(cast("Sequence[AloneOutcome]", found)),
        "uneven-films": lambda found: _films(cast("Sequence[BesideOutcome]", found)),
        "films": lambda found: _films(cast("Sequence[BesideOutcome]", found)),
        "unrelated": lambda found: _unrelated(cast("Sequence[BesideOutcome]", found)),
    }
    what = f"{seeds_in_words(order.seeds)}, {order.count} of each"
    return "\n".join([f"{section}: {_HEADS[section]} {what}.", *makers[section](outcomes)])


_HEADS = {
    "alone": "Bounces by their sound alone: restitution at the second impact. Answered: with an "
    "interval, or ok. Errors, coverage and width (median) are of those. Bound: mean error that "
    "onsets with this jitter allow.",
    "phyphox": "The same clips by phyphox's way, its threshold at its best for each. Hears 3, 5: a "
    "threshold hears the first 3, 5 impacts first. Errors where both answer, at the second impact.",
    "negatives": "Sounds that are no bounce of one ball: verdicts.",
    "films": "Films at 30 fps, sound at 20 dB: restitution at the first impact, without and with "
    "their sound.",
    "uneven": "Each impact returns .3 % more or less than the ball's law says (one standard "
    "deviation): the law's restitution at the second impact, by sound alone.",
    "uneven-films": "Films of such balls: the law's restitution at the first impact.",
    "unrelated": "Tracks at 30 Hz with a sound that is not theirs: how far the value moves, in "
    "widths of its interval. Alone: ok by that sound alone.",
}


def _levels(outcomes: Sequence[AloneOutcome]) -> list[tuple[str, list[AloneOutcome]]]:
    """Return the names of ratios, and the clips of each."""
    good = [one for one in outcomes if one.trial.snr_db >= GOOD_DB]
    each = [
        (f"{snr:g} dB", [one for one in outcomes if one.trial.snr_db == snr]) for snr in SNRS_DB
    ]
    levels = [(f"{GOOD_DB:g} dB or more", good), *each]
    return [(name, found) for name, found in levels if found]


def _alone(outcomes: Sequence[AloneOutcome]) -> list[str]:
    widths = (11, 15, 7, 10, 9, 9, 9, 8, 9, 9, 9, 0)
    head = ("ball", "ratio", "clips", "answered", "ok", "MAE", "median", "worst", "bound")
    lines = [table_line((*head, "jitter", "covered", "width"), widths)]
    for at, which in enumerate(("not named", "named")):
        for level, found in _levels(outcomes):
            answers = [(one, one.named if at else one.unnamed) for one in found]
            told = [(one, answer) for one, answer in answers if answer.is_answered]
            cells = [which, level, str(len(found)), _percent(len(told), len(found))]
            cells.append(_percent(sum(a.verdict == "ok" for _, a in answers), len(found)))
            if told:
                errors = np.array([abs(answer.value - one.truth) for one, answer in told])
                jitters = np.array([one.jitter_s for one, _ in told])
                bounds = np.mean([one.bounds[at] for one, _ in told]) * MEAN_OF_SD
                cells += [f"{v:.5f}" for v in (np.mean(errors), np.median(errors))]
                cells += [f"{np.max(errors):.3f}", f"{bounds:.5f}", _milliseconds(jitters)]
                cells += _covered([(answer, one.truth) for one, answer in told])
            lines.append(table_line(cells, widths))
    return lines


def _phyphox(outcomes: Sequence[AloneOutcome]) -> list[str]:
    widths = (15, 7, 9, 9, 11, 9, 6, 10, 11, 10, 12, 11, 0)
    head = ("ratio", "clips", "hears 3", "hears 5", "not named", "named", "both", "MAE phy.")
    more = ("not named", "named", "median p.", "not named", "named")
    lines = [table_line((*head, *more), widths)]
    for level, found in _levels(outcomes):
        count = len(found)
        both = [
            one
            for one in found
            if np.isfinite(one.phyphox) and one.named.is_answered and one.unnamed.is_answered
        ]
        cells = [level, str(count), _percent(sum(np.isfinite(one.phyphox) for one in found), count)]
        cells.append(_percent(sum(one.phyphox_hears for one in found), count))
        cells.append(_percent(sum(one.unnamed.is_answered for one in found), count))
        cells.append(_percent(sum(one.named.is_answered for one in found), count))
        cells.append(str(len(both)))
        if both:
            errors = np.array(
                [
                    [abs(v - one.truth) for v in (one.phyphox, one.unnamed.value, one.named.value)]
                    for one in both
                ]
            )
            cells += [f"{value:.5f}" for value in np.mean(errors, axis=0)]
            cells += [f"{value:.5f}" for value in np.median(errors, axis=0)]
        lines.append(table_line(cells, widths))
    return lines


def _negatives(outcomes: Sequence[NegativeOutcome]) -> list[str]:
    widths = (14, 7, 7, 9, 0)
    lines = [table_line(("what", "sounds", *_VERDICTS), widths)]
    kinds = dict.fromkeys(one.kind for one in outcomes)
    for kind in ("all", *kinds):
        verdicts = Counter(one.answer.verdict for one in outcomes if kind in ("all", one.kind))
        counts = [str(verdicts[name]) for name in _VERDICTS]
        lines.append(table_line((kind, str(verdicts.total()), *counts), widths))
    return lines


def _films(outcomes: Sequence[BesideOutcome]) -> list[str]:
    widths = (12, 7, 10, 9, 9, 9, 9, 9, 9, 0)
    head = ("sound", "films", "answered", "ok", "MAE", "median", "worst", "covered", "width")
    lines = [table_line((*head, "seconds"), widths)]
    both = [one for one in outcomes if _is_both(one)]
    for which, answers in (
        ("without", [(one.deaf, one) for one in outcomes]),
        ("with", [(one.heard, one) for one in outcomes]),
    ):
        told = [(answer, one.truth) for answer, one in answers if _is_both(one)]
        count = len(answers)
        cells = [which, str(count)]
        cells.append(_percent(sum(answer.is_answered for answer, _ in answers), count))
        cells.append(_percent(sum(answer.verdict == "ok" for answer, _ in answers), count))
        if told:
            errors = np.array([abs(answer.value - truth) for answer, truth in told])
            cells += [f"{v:.5f}" for v in (np.mean(errors), np.median(errors), np.max(errors))]
            cells += _covered(told)
        cells.append(f"{np.median([answer.seconds for answer, _ in answers]):.2f}")
        lines.append(table_line(cells, widths))
    if both:
        lines.append(_ratios(both))
    if any(one.trial.unrelated for one in outcomes):
        lines += _unrelated(outcomes)
    return lines


def _is_both(one: BesideOutcome) -> bool:
    return one.deaf.is_answered and one.heard.is_answered


def _ratios(both: Sequence[BesideOutcome]) -> str:
    errors = np.array([[abs(a.value - one.truth) for a in (one.deaf, one.heard)] for one in both])
    widths = np.array([[one.deaf.width, one.heard.width] for one in both])
    sure = np.isfinite(widths).all(axis=1)
    narrower = np.median(widths[sure, 1] / widths[sure, 0]) if sure.any() else np.nan
    longer = np.median([one.heard.seconds / one.deaf.seconds for one in both])
    ratio = np.mean(errors[:, 1]) / np.mean(errors[:, 0])
    return (
        f"with over without, {len(both)} answered both ways: width (median) {narrower:.2f}, "
        f"MAE {ratio:.2f}, time (median) {longer:.2f}"
    )


def _unrelated(outcomes: Sequence[BesideOutcome]) -> list[str]:
    widths = (17, 7, 9, 9, 11, 15, 0)
    head = ("unrelated sound", "logs", "median", "worst", "within .1", "verdict moved", "alone ok")
    lines = [table_line(head, widths)]
    rows = [
        (what, one.deaf, answer, alone)
        for one in outcomes
        for what, answer, alone in zip(one.trial.unrelated, one.unrelated, one.alone, strict=True)
    ]
    for kind in ("all", *dict.fromkeys(what for what, *_ in rows)):
        mine = [row for row in rows if kind in ("all", row[0])]
        moved = [_moved(deaf, answer) for _, deaf, answer, _ in mine]
        far = np.array([value for value in moved if np.isfinite(value)])
        cells = [kind, str(len(mine))]
        cells += [f"{np.median(far):.3f}", f"{np.max(far):.3f}"] if len(far) else ["", ""]
        cells.append(_percent(int(np.sum(far <= 0.1)), len(far)))
        cells.append(str(sum(deaf.verdict != answer.verdict for _, deaf, answer, _ in mine)))
        cells.append(_percent(sum(alone == "ok" for *_, alone in mine), len(mine)))
        lines.append(table_line(cells, widths))
    return lines


def _moved(deaf: SoundAnswer, heard: SoundAnswer) -> float:
    """Return how far a value moves, in widths of the interval without sound; NaN without one."""
    if not np.isfinite(deaf.width):
        return np.nan
    return abs(heard.value - deaf.value) / deaf.width if np.isfinite(heard.value) else np.inf


def _covered(told: Sequence[tuple[SoundAnswer, float]]) -> list[str]:
    """Return coverage and median width of those that have an interval."""
    sure = [(answer, truth) for answer, truth in told if np.isfinite(answer.width)]
    covered = sum(answer.covers(truth) for answer, truth in sure)
    widths = [answer.width for answer, _ in sure]
    return [_percent(covered, len(sure)), f"{np.median(widths):.4f}" if widths else ""]


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else ""


def _milliseconds(values_s: np.ndarray) -> str:
    known = values_s[np.isfinite(values_s)]
    return f"{1000 * np.median(known):.2f} ms" if len(known) else ""
