"""Tune bounces by their sound, alone and beside pictures, and sounds that are no bounce.

Answers stand beside the truth, the Cramér-Rao bound of onsets with their jitter, and what a user
does today: the "(In)elastic collision" of phyphox.
"""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.study import Order, Part, Row, figure, scored, table
from tunenet_logs.analysis.evaluation.worlds import audio as sounds
from tunenet_logs.analysis.evaluation.worlds.ball import BounceHistory, BounceOrder, bounced
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.known import UNKNOWN_BALL, Ball
from tunenet_logs.terminal import Progress

# ---- Answers to a sound, alone or beside pictures.


def answer_to(episode: Episode, ball: Ball = UNKNOWN_BALL) -> tuple[Row, Array]:
    """Tune an episode; return the answer, and the impact times heard [s], shape (N,).

    NaN stands in an answer where there is none; no times are heard of a video.
    """
    began_s = time.process_time()
    tuning = tune_episode(episode, TuneOptions(ball=ball))
    seconds = time.process_time() - began_s
    record = record_of(tuning)
    found, slope = (record.estimate(name) for name in ("restitution", "restitution_slope"))
    low, high = np.nan, np.nan
    if found is not None and found.interval95 is not None:
        low, high = np.ravel(found.interval95).tolist()[:2]
    answer: Row = {
        "verdict": record.verdict,
        "reason": record.reason or "",
        # restitution at the first impact that the log determines, and the ends of its interval
        "value": np.nan if found is None else float(np.ravel(found.value)[0]),
        "low": low,
        "high": high,
        "slope": np.nan if slope is None else float(np.ravel(slope.value)[0]),
        "seconds": round(seconds, 3),  # of the processor
        # when each impact was, after the log's first sample, and its restitution
        "rebounds": [[one.impact_s, one.restitution] for one in record.rebounds],
    }
    times_s = getattr(tuning.detection, "times_s", None)
    return answer, np.zeros(0) if times_s is None else np.asarray(times_s, np.float64)


def is_answered(row: Row) -> bool:
    """Check whether a user gets a value that counts: with its interval, or "ok"."""
    return bool(np.isfinite(row["value"])) and (row["verdict"] == "ok" or np.isfinite(row["low"]))


def without_sound(episode: Episode) -> Episode:
    """Return the episode without sound."""
    channels = tuple(channel for channel in episode.channels if not channel.sounds)
    return replace(episode, channels=channels, open_sound=None)


# ---- Cramér-Rao bound: how well onsets of a known jitter tell the second impact's restitution.

# Steps of differences and prior standard deviations: of slope and restitution as they are, of the
# others in their logarithm.
_STEPS = {
    "height_m": (1e-3, 0.7),
    "restitution": (1e-4, 0.3),
    "slope": (1e-3, 0.09),
    "drag_1_m": (1e-2, 1.1),  # where the ball is not named
    "contact_s": (2e-2, 1.0),
}


def bound_sd(history: BounceHistory, count: int, jitter_s: float, *, named: bool) -> float:
    """Return the Cramér-Rao bound on the second impact's restitution (standard deviation).

    With priors; unknown are when the recording began, the fall, restitution, slope, drag, and how
    long a contact lasts.

    Args:
        history: the bounce.
        count: how many of its impacts are heard.
        jitter_s: standard deviation of an onset.
        named: whether the ball is, so that its drag is known to a tenth.
    """
    count = min(count, len(history.touches_s))
    rows, gains, priors = [np.ones(count)], [0.0], [0.0]
    for name, (step, prior_sd) in _STEPS.items():
        ahead, behind = (_bounce_moved(history.order, name, way * step) for way in (1, -1))
        shared = min(count, len(ahead.touches_s), len(behind.touches_s))
        change = np.zeros(count)
        change[:shared] = (ahead.touches_s[:shared] - behind.touches_s[:shared]) / (2 * step)
        rows.append(change)
        gains.append((ahead.restitutions[1] - behind.restitutions[1]) / (2 * step))
        priors.append((0.1 if named and name == "drag_1_m" else prior_sd) ** -2)
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


def events_over(samples: NDArray[np.float32], rate_hz: float, threshold: float) -> Array:
    """Return when samples first exceed a threshold [s], shape (N,), six at most, .1 s apart."""
    over = np.flatnonzero(np.abs(samples) > threshold) / rate_hz
    events: list[float] = []
    at = 0
    while at < len(over) and len(events) < 6:
        events.append(float(over[at]))
        at = int(np.searchsorted(over, over[at] + 0.1))
    return np.array(events)


def best_reading(clip: sounds.SoundClip, fewest_events: int = 3) -> float | None:
    """Return the second impact's restitution at the threshold nearest to the truth, if any.

    Only thresholds count at which the first `fewest_events` events are the ball's first impacts: a
    user who hears and sees the ball could know that.
    """
    loudest = float(np.max(np.abs(clip.samples)))
    # 60 from .3 % of the loudest sample on, and what is set unless a user sets another
    thresholds = (*(loudest * np.geomspace(0.003, 0.99, 60)).tolist(), 0.1)
    good: list[float] = []
    for threshold in thresholds:
        events = events_over(clip.samples, clip.rate_hz, threshold)
        both = min(len(events), len(clip.impacts_s))
        off_s = events[:both] - clip.impacts_s[:both]
        right = (off_s >= -0.001) & (off_s <= 0.02)  # of the beginning of an impact's sound
        if len(right) >= fewest_events and right[:fewest_events].all():
            first, second = np.diff(events[:3])
            good.append(float(second / first))
    return min(good, key=lambda one: abs(one - clip.restitutions[1]), default=None)


# ---- Sound alone: bounces, by the product and by phyphox's way, and sounds that are no bounce.

SNRS_DB = (40.0, 30.0, 20.0, 10.0, 5.0)


@dataclass(frozen=True)
class AloneTrial:
    """Clip to be heard."""

    seed: int  # of it
    number: int  # likewise; every second one went through AAC
    snr_db: float  # see `impact_ratio`
    uneven: float = 0.0  # see `BounceOrder`


def alone_rows(trial: AloneTrial) -> list[list[Row]]:
    """Tune a clip, with the ball not named and named, and read it as phyphox does: three rows."""
    codec = "aac" if trial.number % 2 else "pcm"
    clip = sounds.draw_sound(
        trial.seed, trial.number, snr_db=trial.snr_db, codec=codec, uneven=trial.uneven
    )
    scene = clip.scene
    episode = sound_alone(clip)
    unnamed, times_s = answer_to(episode)
    named, _ = answer_to(episode, scene.told)
    off = onset_errors_s(times_s, clip.impacts_s)
    jitter_s = float(np.sqrt(np.mean(off**2))) if len(off) > 2 else np.nan
    usual_s = 0.0002 if not np.isfinite(jitter_s) else max(jitter_s, 1e-5)
    head = {
        "seed": trial.seed,
        "number": trial.number,
        "what": scene.what,
        "background": clip.background,
        "snr_db": trial.snr_db,
        "truth": float(scene.history.by_law[1]),  # at the second impact, by the ball's law
        "impacts": scene.audible,
        "jitter_s": jitter_s,  # rms error of the onsets that were used; NaN of fewer than three
    }
    rows: list[Row] = []
    for which, is_named, answer in (("not named", False, unnamed), ("named", True, named)):
        # least standard deviation of a value from onsets with this jitter
        bound = bound_sd(scene.history, scene.audible, usual_s, named=is_named)
        rows.append({**head, "with": f"ball {which}", "bound": bound, **answer})
    best, hears_five = best_reading(clip), best_reading(clip, 5) is not None
    value = np.nan if best is None else best
    rows.append({**head, "with": "phyphox", "value": value, "hears_five": hears_five})
    return [rows]


def sound_alone(heard: sounds.SoundClip | sounds.NoBounce) -> Episode:
    """Build a log that holds this sound and nothing else."""
    return sounds.with_sound(Episode(EpisodeInfo(), {}), heard)


def negative_rows(case: tuple[int, int]) -> list[list[Row]]:
    """Tune the negative of a seed and a number."""
    heard = sounds.draw_negative(*case)
    head = {"seed": case[0], "number": case[1], "what": heard.kind, "with": "sound alone"}
    return [[{**head, **answer_to(sound_alone(heard))[0]}]]


# ---- Sound beside pictures: videos and tracks with their own sound, another's, or none.

FILM_SNR_DB = 20.0
UNRELATED = ("noise", "speech", "music", "silence")
_RATE_HZ = 48_000


@dataclass(frozen=True)
class BesideTrial:
    """One video or track."""

    kind: str  # "film" or "track"
    seed: int  # of it
    number: int  # likewise
    unrelated: tuple[str, ...] = ()  # sounds of `UNRELATED` that are put beside it in turn
    uneven: float = 0.0  # of a film, see `BounceOrder`


def beside_rows(trial: BesideTrial) -> list[list[Row]]:
    """Tune a trial with each sound, each from a log that was opened afresh.

    Rows: without sound, with its own, and of each unrelated sound two: beside the pictures, and
    the verdict on it alone.
    """
    if trial.kind == "track":
        made = sounds.track_with_sound(trial.seed, trial.number, FILM_SNR_DB)
    else:
        made = sounds.film_with_sound(trial.seed, trial.number, FILM_SNR_DB, uneven=trial.uneven)
    head: Row = {
        "seed": trial.seed,
        "number": trial.number,
        "what": trial.kind,
        "background": made.clip.background,  # behind its own sound
        "truth": made.restitution,  # at the first impact
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        if isinstance(made, sounds.FilmedSound):
            made.write(path)

        def opened() -> Episode:
            return read_episode(path) if isinstance(made, sounds.FilmedSound) else made.episode()

        rows = [
            {**head, "with": "no sound", **answer_to(without_sound(opened()))[0]},
            {**head, "with": "its sound", **answer_to(opened())[0]},
        ]
        lasts_s = made.clip.scene.lasts_s
        others = {
            what: unrelated_sound(what, lasts_s, trial.seed, trial.number)
            for what in trial.unrelated
        }
        for what, other in others.items():
            answer, _ = answer_to(sounds.with_sound(without_sound(opened()), other))
            rows.append({**head, "with": what, **answer})
        for what, other in others.items():
            verdict = answer_to(sound_alone(other))[0]["verdict"]
            alone = {"what": "sound alone", "with": what, "truth": None, "verdict": verdict}
            rows.append({**head, **alone})
    return [rows]


def unrelated_sound(what: str, lasts_s: float, seed: int, number: int) -> sounds.NoBounce:
    """Synthesise noise, speech, music or silence as long as a video, through AAC."""
    rng = np.random.default_rng([4_000_000 + seed, number, *what.encode()])
    samples = np.zeros(int(lasts_s * _RATE_HZ))
    if what != "silence":
        made = sounds.background_sound(cast("sounds.Background", what), lasts_s, _RATE_HZ, rng)
        made = made[: len(samples)]
        samples[: len(made)] = rng.uniform(0.1, 0.9) * made / np.max(np.abs(made))
    heard = sounds.NoBounce(samples.astype(np.float32), _RATE_HZ, "pcm", what)
    return replace(heard, samples=sounds.through_aac(heard.samples, _RATE_HZ), codec="aac")


# ---- Run: section by section.

# Signal-to-noise ratio [dB] of a good sound, or more; unevenness of a ball, see `BounceOrder`.
GOOD_DB, UNEVEN = 20.0, 0.003

Trials = list[list[Row]]  # of a section: the rows of each clip, sound, film or track


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Run the trials of each section; "alone" and "phyphox" share their clips."""
    pairs = [(seed, at) for seed in order.seeds for at in range(order.targets)]
    uneven_films = [BesideTrial("film", *one, uneven=UNEVEN) for one in pairs]
    tracks = [BesideTrial("track", *one, UNRELATED) for one in pairs]
    # one unrelated sound in turn
    films = [BesideTrial("film", *one, (UNRELATED[one[1] % len(UNRELATED)],)) for one in pairs]
    # By section: the work, what is asked of it, and its unit.
    work: dict[str, tuple[Callable[[Any], Trials], list[Any], str]] = {
        "alone": (alone_rows, [AloneTrial(*one, snr) for snr in SNRS_DB for one in pairs], "clip"),
        "uneven": (alone_rows, [AloneTrial(*one, GOOD_DB, UNEVEN) for one in pairs], "clip"),
        "negatives": (negative_rows, pairs, "sound"),
        "films": (beside_rows, films, "film"),
        "unrelated": (beside_rows, tracks, "track"),
        "uneven-films": (beside_rows, uneven_films, "film"),
    }
    found: dict[str, Trials] = {}
    what = f"{order.seeds_in_words}, {order.targets} of each"
    for section in order.sections:
        made_by = "alone" if section == "phyphox" else section
        is_new = made_by not in found
        if is_new:
            score, asked, unit = work[made_by]
            cases = {made_by: [Piece(one) for one in asked]}
            found |= scored(score, cases, order, progress, (section, unit))
        title, lines = _TABLES[section]
        text = table(lines(found[made_by]), f"{section}: {title} {what}.")
        rows = [row for trial in found[made_by] for row in trial] if is_new else []
        yield Part(section, text, rows)


# ---- Tables for a terminal.

_VERDICTS = ("ok", "suspect", "rejected")


def _levels(trials: Trials) -> list[tuple[str, Trials]]:
    """Return the names of ratios, and the clips of each."""
    good = [one for one in trials if one[0]["snr_db"] >= GOOD_DB]
    each = [(f"{snr:g} dB", [one for one in trials if one[0]["snr_db"] == snr]) for snr in SNRS_DB]
    return [(name, some) for name, some in ((f"{GOOD_DB:g} dB or more", good), *each) if some]


def _alone(trials: Trials) -> list[list[str]]:
    head = ["ball", "ratio", "clips", "answered", "ok", "MAE", "median", "worst", "bound"]
    lines = [[*head, "jitter", "covered", "width"]]
    for at, which in enumerate(("not named", "named")):
        for level, some in _levels(trials):
            answers = [one[at] for one in some]
            told = [row for row in answers if is_answered(row)]
            cells = [which, level, str(len(some)), *_rates(answers)]
            if told:
                mean, median, worst = _errors(told)
                bound = float(np.mean([row["bound"] for row in told])) * float(np.sqrt(2 / np.pi))
                jitter_ms = figure([1000 * row["jitter_s"] for row in told], np.median)
                cells += [f"{mean:.5f}", f"{median:.5f}", f"{worst:.3f}", f"{bound:.5f}"]
                cells += ["" if jitter_ms is None else f"{jitter_ms:.2f} ms", *_covered(told)]
            lines.append(cells)
    return lines


def _phyphox(trials: Trials) -> list[list[str]]:
    head = ["ratio", "clips", "hears 3", "hears 5", "not named", "named", "both", "MAE phy."]
    lines = [[*head, "not named", "named", "median p.", "not named", "named"]]
    for level, some in _levels(trials):
        count = len(some)
        both = [
            (phyphox, unnamed, named)
            for unnamed, named, phyphox in some
            if np.isfinite(phyphox["value"]) and is_answered(named) and is_answered(unnamed)
        ]
        cells = [level, str(count)]
        cells.append(_share(sum(np.isfinite(one[2]["value"]) for one in some), count))
        cells.append(_share(sum(one[2]["hears_five"] for one in some), count))
        cells += [_share(sum(is_answered(one[at]) for one in some), count) for at in (0, 1)]
        cells.append(str(len(both)))
        if both:
            errors = [_errors(rows) for rows in zip(*both, strict=True)]
            cells += [f"{mean:.5f}" for mean, _, _ in errors]
            cells += [f"{median:.5f}" for _, median, _ in errors]
        lines.append(cells)
    return lines


def _negatives(trials: Trials) -> list[list[str]]:
    lines = [["what", "sounds", *_VERDICTS]]
    for kind in ("all", *dict.fromkeys(row["what"] for (row,) in trials)):
        verdicts = Counter(row["verdict"] for (row,) in trials if kind in ("all", row["what"]))
        counts = [str(verdicts[name]) for name in _VERDICTS]
        lines.append([kind, str(verdicts.total()), *counts])
    return lines


def _films(trials: Trials) -> list[list[str]]:
    head = ["sound", "films", "answered", "ok", "MAE", "median", "worst", "covered", "width"]
    lines = [[*head, "seconds"]]
    both = [one[:2] for one in trials if is_answered(one[0]) and is_answered(one[1])]
    for at, which in enumerate(("without", "with")):
        answers = [one[at] for one in trials]
        cells = [which, str(len(answers)), *_rates(answers)]
        if both:
            told = [one[at] for one in both]
            cells += [*(f"{value:.5f}" for value in _errors(told)), *_covered(told)]
        seconds = f"{np.median([row['seconds'] for row in answers]):.2f}"
        lines.append([*cells, *[""] * (len(head) - len(cells)), seconds])
    if both:
        deaf, heard = ([one[at] for one in both] for at in (0, 1))
        narrower = figure([_width(b) / _width(a) for a, b in both], np.median)
        longer = figure([b["seconds"] / a["seconds"] for a, b in both], np.median)
        ratio = _errors(heard)[0] / _errors(deaf)[0]
        width = np.nan if narrower is None else narrower
        words = f"with over without, {len(both)} answered both ways: width (median) {width:.2f}, "
        lines.append([f"{words}MAE {ratio:.2f}, time (median) {longer:.2f}"])
    return [*lines, *(_unrelated(trials) if len(trials[0]) > 2 else ())]


def _unrelated(trials: Trials) -> list[list[str]]:
    lines = [
        ["unrelated sound", "logs", "median", "worst", "within .1", "verdict moved", "alone ok"]
    ]
    answers: list[tuple[Row, Row, Row]] = []  # without sound, with the unrelated one, it alone
    for deaf, _, *others in trials:
        count = len(others) // 2
        answers += [(deaf, *both) for both in zip(others[:count], others[count:], strict=True)]
    for kind in ("all", *dict.fromkeys(with_it["with"] for _, with_it, _ in answers)):
        mine = [one for one in answers if kind in ("all", one[1]["with"])]
        moved = [_moved(deaf, with_it) for deaf, with_it, _ in mine]
        far = np.array([value for value in moved if np.isfinite(value)])
        cells = [kind, str(len(mine))]
        cells += [f"{np.median(far):.3f}", f"{np.max(far):.3f}"] if len(far) else ["", ""]
        cells.append(_share(int(np.sum(far <= 0.1)), len(far)))
        cells.append(str(sum(deaf["verdict"] != it["verdict"] for deaf, it, _ in mine)))
        cells.append(_share(sum(alone["verdict"] == "ok" for *_, alone in mine), len(mine)))
        lines.append(cells)
    return lines


_UNEVEN = "Each impact returns .3 % more or less than the ball's law says (one standard deviation)"
# By section: what its table shows, and its lines.
_TABLES: dict[str, tuple[str, Callable[[Trials], list[list[str]]]]] = {
    "alone": (
        "Bounces by their sound alone: restitution at the second impact. Answered: with an "
        "interval, or ok. Errors, coverage and width (median) are of those. Bound: mean error that "
        "onsets with this jitter allow.",
        _alone,
    ),
    "phyphox": (
        "The same clips by phyphox's way, its threshold at its best for each. Hears 3, 5: a "
        "threshold hears the first 3, 5 impacts first. Errors where both answer, at the second "
        "impact.",
        _phyphox,
    ),
    "negatives": ("Sounds that are no bounce of one ball: verdicts.", _negatives),
    "films": (
        "Films at 30 fps, sound at 20 dB: restitution at the first impact, without and with "
        "their sound.",
        _films,
    ),
    "uneven": (f"{_UNEVEN}: the law's restitution at the second impact, by sound alone.", _alone),
    "uneven-films": ("Films of such balls: the law's restitution at the first impact.", _films),
    "unrelated": (
        "Tracks at 30 Hz with a sound that is not theirs: how far the value moves, in "
        "widths of its interval. Alone: ok by that sound alone.",
        _unrelated,
    ),
}


def _width(row: Row) -> float:
    return row["high"] - row["low"]


def _moved(deaf: Row, heard: Row) -> float:
    """Return how far a value moves, in widths of the interval without sound; NaN without one."""
    if not np.isfinite(_width(deaf)):
        return np.nan
    moved = abs(heard["value"] - deaf["value"]) / _width(deaf)
    return moved if np.isfinite(heard["value"]) else np.inf


def _errors(rows: Sequence[Row]) -> tuple[float, float, float]:
    """Return mean, median and largest absolute error."""
    errors = np.abs([row["value"] - row["truth"] for row in rows])
    return float(np.mean(errors)), float(np.median(errors)), float(np.max(errors))


def _rates(rows: Sequence[Row]) -> list[str]:
    """Return how many are answered, and ok."""
    ok = sum(row["verdict"] == "ok" for row in rows)
    return [_share(sum(map(is_answered, rows)), len(rows)), _share(ok, len(rows))]


def _covered(rows: Sequence[Row]) -> list[str]:
    """Return coverage and median width of those that have an interval."""
    sure = [row for row in rows if np.isfinite(_width(row))]
    covered = sum(row["low"] <= row["truth"] <= row["high"] for row in sure)
    return [_share(covered, len(sure)), f"{np.median(list(map(_width, sure))):.4f}" if sure else ""]


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else ""
