"""Drop as it was heard: impact times in an episode, and the estimation problem they pose.

The times are a signal's, or the onsets of a sound. The tuned simulator is compared with them at the
end: it is on the table at each impact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tunenet_logs.analysis.drop import RIGHT_SOUND, RIGHT_TIMES
from tunenet_logs.analysis.drop.times.model import DropSetup, HeardBall, heard_ball
from tunenet_logs.analysis.drop.times.search import BallAmong, ball_among
from tunenet_logs.analysis.estimators.base import FitResult, Observation, Problem, Step, Trace
from tunenet_logs.analysis.onsets import Onsets, onsets
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import MAX_SAMPLES, Curves, Motion
from tunenet_logs.episode import Array, Episode, LeftOut, Sound
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.reader import check_start
from tunenet_logs.recorders.simulators.ball import TOPIC, DropRig, DropSimulator, lands_after_s
from tunenet_logs.recorders.simulators.base import CALIBRATED, GRAVITY_M_S2
from tunenet_logs.recorders.simulators.known import Ball
from tunenet_logs.terminal import listed


@dataclass(frozen=True, eq=False)
class Listened:
    """Sound, and the onsets in the chosen part of it."""

    sound: Sound  # all of it
    knocks: Onsets  # of the part, their times on the sound's clock
    part_s: tuple[float, float]  # first and last moment of the part, on the same clock


def listened(episode: Episode, selection: TuneOptions) -> Listened:
    """Detect the onsets in an episode's sound; `NotFoundError` where there is none to hear."""
    topic = selection.topic
    if topic is not None and topic not in episode.sound_topics:
        what = f"no sound in topic {topic} (there is: {listed(episode.sound_topics)})"
        raise NotFoundError(what, "name one of these with --topic, or leave it out")
    sound = episode.sounds(topic)
    if sound is None:
        raise NotFoundError("no sound")
    check_start(selection.start_s, sound.lasts_s)
    begin_s = selection.start_s or 0.0
    end_s = min(selection.end_s or np.inf, sound.lasts_s)
    if not np.any(sound.samples):
        raise NotFoundError(f"{sound.name}: the sound is silent", RIGHT_SOUND)
    knocks = onsets(sound)
    inside = (knocks.times_s >= begin_s) & (knocks.times_s <= end_s)
    return Listened(sound, knocks.only(inside), (begin_s, end_s))


# ---- Impact times of one signal, and the simulator that hits the table when the ball did

MIN_IMPACTS = 3  # two flights: their durations' ratio is one restitution
_NO_ODDS = -5.0  # logarithm of the odds against noises below which the times are none of a ball
_SAME_S = 1e-7  # moments that differ by less are one sample of a rollout


@dataclass(frozen=True, eq=False)
class TimesDetection:
    """Impact times of one signal."""

    topic: str  # the signal
    start_ns: int  # where the log's clock is 0: the signal's first time
    times_s: Array  # of all that was heard in the selection, on the log's clock, shape (N,)
    rig: DropSetup  # what is known beside them
    ball: Ball  # what was dropped, as far as it is known
    warnings: tuple[str, ...] = ()  # for the user
    # The sound that they were found in; None where a log gives times.
    listened: Listened | None = None
    left_out: tuple[LeftOut, ...] = ()  # what the signal or the sound lacks

    @property
    def uses_ball(self) -> bool:
        """Whether the ball's size and mass have an effect: on the air's drag."""
        return self.ball.drag_1_m is not None

    @cached_property
    def heard(self) -> HeardBall:
        """Ball that explains the times; where none does, `NotFoundError` says what they are."""
        if self.listened is not None:
            if self.among is None or self.among.ball.log_odds < _NO_ODDS:
                raise NotFoundError(
                    f"{self.topic}: {len(self.times_s)} knocks are heard, but no ball that "
                    "bounces: its knocks follow each other faster and faster, and get softer",
                    RIGHT_SOUND,
                )
            return self.among.ball
        found = heard_ball(self.times_s, self.rig)
        apart_s = np.diff(self.times_s)
        refused = (
            f"{len(self.times_s)} times, {1000 * apart_s.min():.4g} to {1000 * apart_s.max():.4g} "
            "ms apart, are no bouncing ball's: from impact to impact its flights get shorter by a "
            "ratio"
        )
        if found is None:
            raise NotFoundError(refused, RIGHT_TIMES)
        if found.values[0] >= 0.985 and found.told:  # no ball keeps its height
            even = f"these beats are nearly even ({found.values[0]:.3f})"
            raise NotFoundError(f"{refused}; {even}", RIGHT_TIMES)
        if found.log_odds < _NO_ODDS:
            better = "noises at random times explain them better"
            raise NotFoundError(f"{refused}; {better}", RIGHT_TIMES)
        return found

    @cached_property
    def among(self) -> BallAmong | None:
        """Ball among the onsets of a sound; None where nothing sounds like one."""
        if self.listened is None:
            return None
        begin_s, end_s = self.listened.part_s
        return ball_among(self.listened.knocks, end_s - begin_s, self.rig)

    @property
    def window(self) -> Mapping[str, float]:
        """First and last impact, and the first whose restitution is reported [s]."""
        heard = self.heard
        first_s, last_s = heard.times_s[[0, -1]].tolist()
        told_s = float(heard.predicted_s[heard.told])
        return {"start_s": first_s, "impact_s": told_s, "end_s": last_s}

    @property
    def extent(self) -> tuple[str, str]:
        """Count of the impacts heard, as label and text."""
        return "drop", f"{len(self.heard.times_s)} impacts"

    @cached_property
    def target(self) -> Observation:
        """Target observation o_T: heard impact times less the contacts before; NaN if not heard."""
        heard = self.heard
        values = np.full(int(heard.numbers.max()) + 1, np.nan)
        values[heard.numbers] = heard.heard_contactless_s * heard.seconds_s
        return _observation(values[heard.told :])

    @cached_property
    def rig_of_rollouts(self) -> DropRig:
        """Rig whose fall ends with the first reported impact, and as many bounces.

        The clock's zero is the log's; without a clock, seconds are those of the fit. Its impacts
        take no time, so its clock is less by the contacts; see `HeardBall.contactless_s`.
        """
        heard = self.heard
        fall_m = heard.fall_m
        lasts_s = lands_after_s(fall_m, 0.0, GRAVITY_M_S2, float(heard.values[2]))
        impacts_s = heard.contactless_s * heard.seconds_s
        release_s = float(impacts_s[heard.told]) - lasts_s
        apart_s = np.diff(impacts_s)
        until_s = float(impacts_s[-1] + 0.5 * apart_s[-1]) - release_s
        # 16 samples in the shortest flight, 20,000 in all.
        rate_hz = min(float(np.clip(16 / apart_s.min(), 250.0, 2000.0)), 20_000 / until_s)
        even_s = np.arange(int(np.ceil(until_s * rate_hz)) + 1) / rate_hz
        heard_s = heard.heard_contactless_s * heard.seconds_s - release_s
        own = heard_s[heard_s > 0]
        apart = np.abs(own[:, None] - even_s).min(axis=1) > _SAME_S
        return DropRig(
            gap_m=fall_m,
            rate_hz=rate_hz,
            samples=len(even_s),
            start_ns=self.start_ns + round(1e9 * release_s),
            times_s=tuple(np.sort(np.append(even_s, own[apart])).tolist()),
        )


def times_problem(detection: TimesDetection, initial: Array) -> Problem:
    """Pose the estimation problem, with a simulator that hits the table when the ball was heard to.

    `initial` are restitution, slope and drag [1/m], or the first of these.
    """
    heard = detection.heard
    try:
        rig = detection.rig_of_rollouts
    except UsageError as error:
        flights_s = np.diff(heard.times_s)
        if detection.among is not None:
            raise NotFoundError(
                f"{detection.topic}: no ball that bounces is heard: the best knocks are "
                f"{1000 * flights_s.min():.4g} to {1000 * flights_s.max():.4g} ms apart, which is "
                "a rattle",
                RIGHT_SOUND,
            ) from error
        raise NotFoundError(
            f"these impacts cannot be simulated: {error}; flights of {1000 * flights_s.min():.4g} "
            f"to {1000 * flights_s.max():.4g} ms: are the times in seconds?",
            RIGHT_TIMES,
        ) from error
    count = len(detection.target.axis)

    def exact_fit(start: Array) -> FitResult:
        """Return the ball that explains all times best, as many values as `start` has."""
        asked = slice(len(start))
        return FitResult(heard.values[asked], heard.interval95[asked], detail=heard.rebounds)

    return Problem(
        detection.target,
        DropSimulator(rig, CALIBRATED),
        lambda episode: _observation(rollout_impacts(episode, rig, detection.start_ns, count)),
        initial,
        exact_fit,
        np.array([1.0, 1.0, 1 / rig.gap_m])[: len(initial)],
    )


def rollout_impacts(episode: Episode, rig: DropRig, start_ns: int, count: int) -> Array:
    """Locate the first impacts of a rollout in its heights, shape (count,) [s]; NaN of none.

    The last two samples of a flight say where it goes on to: it falls with g.
    """
    signal = episode.signals[TOPIC]
    seconds = (signal.stamps_ns - rig.start_ns).astype(np.float64) * 1e-9
    places = seconds * rig.rate_hz
    even = np.abs(places - np.round(places)) < 1e-3 * rig.rate_hz * _SAME_S + 1e-4
    seconds, gaps = seconds[even], signal.values[even, 2] - rig.radius_m
    inner = gaps[1:-1]
    lowest = np.flatnonzero((inner < gaps[:-2]) & (inner <= gaps[2:])) + 1
    found = np.full(count, np.nan)
    for number, at in enumerate(lowest[lowest >= 3][:count].tolist()):
        apart_s = seconds[at - 1] - seconds[at - 2]
        speed = (gaps[at - 1] - gaps[at - 2]) / apart_s
        before = (gaps[at - 2] - gaps[at - 3]) / (seconds[at - 2] - seconds[at - 3])
        bend = (speed - before) / (seconds[at - 1] - seconds[at - 3])
        speed += bend * apart_s
        falls = -speed + np.sqrt(max(speed**2 - 4 * bend * gaps[at - 1], 0.0))
        found[number] = seconds[at - 1] + 2 * gaps[at - 1] / falls
    return found + (rig.start_ns - start_ns) * 1e-9


def _observation(values: Array) -> Observation:
    axis = np.arange(1.0, len(values) + 1)
    return Observation(values[:, None], axis, "impact", ("time [s]",))


def signals_in(episode: Episode, topic: str | None) -> list[str]:
    """Return the names of the impact-time signals, those with the most impacts first."""
    signals = episode.signals.values() if topic is None else episode.signals_of(topic)
    named = [one for one in signals if one.columns == ("impact",) and not one.drives]
    return [one.name for one in sorted(named, key=lambda one: -len(one.stamps_ns))]


# ---- Tuned simulator compared with what was heard


def heard_heights_m(detection: TimesDetection, step: Step) -> tuple[Array, Array]:
    """Return an iterate's times on the log's clock [s] and heights on the table [m], each (T,)."""
    assert step.evaluation is not None
    signal = next(iter(step.evaluation.episode.signals.values()))
    seconds = (signal.stamps_ns - detection.start_ns).astype(np.float64) * 1e-9
    heights_m = signal.values[:, 2] - detection.rig_of_rollouts.radius_m
    return detection.heard.with_contacts(seconds / detection.heard.seconds_s), heights_m


def heard_motion(detection: TimesDetection, trace: Trace) -> Motion:
    """Return the rollout's height; the observed one is 0 at each impact heard, else unknown."""
    # What the times leave to what is known of balls: 0.15 wide, an interval is a prior's.
    slope, drag = np.ptp(detection.heard.interval95[1:], axis=1).tolist()
    unknown: list[str] = []
    if slope > 0.15:
        unknown.append("these times cannot determine the slope: its interval is the prior's")
    if drag > 0.15 and detection.rig.drag_1_m is None:
        unknown.append(
            "these times cannot determine the drag: its interval is the prior's (see --ball)"
        )
    if not detection.rig.has_clock:
        return Motion(unidentifiable=tuple(unknown))
    seconds, heights_m = heard_heights_m(detection, trace.steps[-1])
    observed_m = np.full(len(seconds), np.nan)
    heard_s = detection.heard.with_contacts(detection.heard.heard_contactless_s)
    same_s = 5e-9  # stamps that differ by less are of one moment
    at = np.clip(np.searchsorted(seconds, heard_s - same_s), 0, len(seconds) - 1)
    there = np.abs(seconds[at] - heard_s) <= same_s
    observed_m[at[there]] = 0.0
    every = max(1, -(-len(seconds) // (MAX_SAMPLES // 2)))
    kept = np.union1d(np.arange(0, len(seconds), every), at[there])
    curves = Curves(detection.start_ns, seconds[kept], observed_m[kept], heights_m[kept])
    return Motion(curves=curves, unidentifiable=tuple(unknown))
