"""A drop from recorded positions: the ball's coefficient of restitution from its height."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.checks import Check, CrossCheck
from analysis.drop import observations as views
from analysis.drop.checks import (
    fall_checks,
    fit_check,
    motion_checks,
    rebound_check,
    recording_checks,
    sure_check,
)
from analysis.drop.cross_checks import flight_cross_check
from analysis.drop.detection import DropDetection, drop_problem
from analysis.drop.free_fall import Drop, find_drops, outliers
from analysis.drop.motion import simulation_fit, tuned_motion
from analysis.drop.presets import PAPER_HEIGHT_M, PRESETS
from analysis.drop.rebounds import reported_rebounds
from analysis.estimators.base import FitResult, Step
from analysis.experiment import Claim
from analysis.selection import Selection, check_start
from recorders.simulators.balls import Ball, completed, recorded_ball
from recorders.simulators.drop import TOPIC
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.terminal import listed
from tunenet_logs.timestamp_correction import correct_late_stamps

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from analysis.record import Tuning

_AXES = {"+z": (2, 1), "-z": (2, -1), "+y": (1, 1), "-y": (1, -1), "+x": (0, 1), "-x": (0, -1)}
"""Column and sign of what may be up, the likeliest first."""

_POSITION = ("x", "y", "z")

_PAPER_FIT, _NOISE_SHARE = 0.03, 1.2
"""Rms [drop heights] that the paper's 60 Hz simulator may be off, and how much of the noise adds
to it: what white noise alone hardly exceeds."""

_FARTHEST_M = 1e6
"""A coordinate beyond it is a marker for "none"."""


class DropFromPositions:
    """See `Experiment`."""

    name = "drop"
    kind = "drop"
    occasion = "drop"
    presets = PRESETS
    problem = staticmethod(drop_problem)
    motion = staticmethod(tuned_motion)
    rebounds = staticmethod(reported_rebounds)

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """By its positions: a tree of frames is in every robot's log; see `Experiment.claim`."""
        signals = episode.signals.values() if topic is None else episode.signals_of(topic)
        positions = [signal.name for signal in signals if _is_position(signal)]
        if not positions:
            return Claim.NONE
        frames = all(name.startswith("/tf") and "ball" not in name for name in positions)
        return Claim.PERHAPS if frames else Claim.PLAINLY

    def detect(self, episode: Episode, selection: Selection, preset: str) -> DropDetection:
        """The first drop of the ball's signal; see `Experiment.detect`."""
        reasons: list[str] = []
        unused: list[str] = []
        if selection.arm_options:
            unused.append(f"{', '.join(selection.arm_options)} not used: this is a drop")
        if selection.film_options:  # nobody should think that they had an effect
            topics = episode.picture_topics
            there = (
                f"to use its pictures: --topic {topics[0]}" if topics else "it holds no pictures"
            )
            named = ", ".join(selection.film_options)
            unused.append(f"{named} not used: the log holds the ball's position ({there})")
        for signal in _candidates(episode, selection):
            try:
                check_start(selection.start_s, float(signal.seconds[-1]))
                arrivals = correct_late_stamps(signal.stamps_ns)
                even = replace(signal, stamps_ns=arrivals.stamps_ns)
                ball = completed(selection.ball, recorded_ball(episode.info))
                detection = _detect_in(even, int(signal.stamps_ns[0]), selection, preset, ball)
                late = arrivals.warnings("samples")
                return replace(detection, warnings=(*detection.warnings, *late, *unused))
            except NotFoundError as reason:
                reasons.append(f"{signal.name}: {reason}")
        raise NotFoundError("; ".join((reasons[0], *unused)))

    def checks(
        self, detection: DropDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        assert last.evaluation is not None
        drop = detection.drop
        checks = recording_checks(drop, detection.sideways_m)
        if not detection.physical:  # the paper's simulator has a drag of its own
            most = _PAPER_FIT + _NOISE_SHARE * drop.noise_m / drop.drop_height_m
            simulated = last.evaluation.observation
            return (*checks, fit_check(simulated, detection.target, drop.drop_height_m, most))
        value = float(last.values[0])
        checks += fall_checks(drop, value)
        checks.append(sure_check(*fit.interval95[0]) if fit else rebound_check(drop, value))
        return (*checks, *motion_checks(simulation_fit(detection, last)))

    def cross_check(self, detection: DropDetection, estimate: Array) -> CrossCheck | None:
        """See `flight_cross_check`."""
        return flight_cross_check(detection, estimate)

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """See `Experiment.review`."""
        if tuning.detection is None:
            return None
        from analysis.drop.review.views import log_drop

        return log_drop(stream, tuning)


def _candidates(episode: Episode, selection: Selection) -> list[Signal]:
    """Position signals in the order in which to try them."""
    if selection.topic is not None:
        positions = [one for one in episode.signals_of(selection.topic) if _is_position(one)]
        if not positions:
            usable = {name for name, one in episode.signals.items() if _is_position(one)}
            known = listed(sorted({*usable, *episode.picture_topics})) or "none"
            raise NotFoundError(f"no usable topic {selection.topic}; there is: {known}")
    else:
        positions = [one for one in episode.signals.values() if _is_position(one)]
    if not positions:
        seen = listed(f"{one.topic} ({one.type_name or 'no type'})" for one in episode.channels)
        raise NotFoundError(
            f"no channel with the position of a ball or pictures of it; channels: {seen or 'none'}"
        )
    return sorted(positions, key=lambda one: (one.name != TOPIC, "ball" not in one.name, one.name))


def _is_position(signal: Signal) -> bool:
    return signal.columns == _POSITION and signal.unit == "m"


def _detect_in(
    signal: Signal, start_ns: int, selection: Selection, preset: str, ball: Ball
) -> DropDetection:
    """The first drop in the selected part, without the samples that hold no position."""
    seconds = signal.seconds
    keep: NDArray[np.bool_] = np.all(np.abs(signal.values) < _FARTHEST_M, axis=1)  # NaN is not
    if selection.start_s is not None:
        keep &= seconds >= selection.start_s
    if selection.end_s is not None:
        keep &= seconds <= selection.end_s
    signal = replace(signal, stamps_ns=signal.stamps_ns[keep], values=signal.values[keep])
    if not len(signal.stamps_ns):
        raise NotFoundError("no sample with a position (in the part that was selected)")
    up, kept, drops = _vertical_drops(signal, start_ns)
    column, _ = _AXES[up]
    drop = drops[0]
    window = slice(drop.first, drop.first + len(drop.seconds))
    warnings = [] if up == "+z" else [f"up is {up} in {signal.name}"]
    if len(drops) > 1:
        spans = ", ".join(f"{one.seconds[0]:.2f} to {one.seconds[-1]:.2f} s" for one in drops)
        warnings.append(f"{len(drops)} drops ({spans}); the first is used (see --start, --end)")
    if not PRESETS[preset].physical:
        warnings += _paper_warnings(drop)
    return DropDetection(
        physical=PRESETS[preset].physical,
        topic=signal.name,
        start_ns=start_ns,
        found=drop,
        outliers=_between(signal, drop, start_ns) - len(drop.seconds),
        sideways_m=np.delete(kept.values, column, axis=1)[window],
        ball=ball,
        warnings=tuple(warnings),
    )


def _vertical_drops(signal: Signal, start_ns: int) -> tuple[str, Signal, list[Drop]]:
    """Which way is up (+z if in doubt), the signal without outliers, and the drops along it."""
    low, high = np.quantile(signal.values, (0.001, 0.999), axis=0)
    first_reason: NotFoundError | None = None
    for up, (column, sign) in _AXES.items():
        if (high - low)[column] < 0.5 * (high - low).max():
            continue
        seconds = (signal.stamps_ns - start_ns).astype(np.float64) * 1e-9
        keep = np.logical_not(outliers(seconds, signal.values[:, column]))
        kept = replace(signal, stamps_ns=signal.stamps_ns[keep], values=signal.values[keep])
        seconds = (kept.stamps_ns - start_ns).astype(np.float64) * 1e-9
        try:
            return up, kept, find_drops(seconds, sign * kept.values[:, column])
        except NotFoundError as reason:
            first_reason = first_reason or reason
    raise first_reason or NotFoundError("the ball does not move")


def _between(signal: Signal, drop: Drop, start_ns: int) -> int:
    """How many samples a drop would have with those that were left out."""
    seconds = (signal.stamps_ns - start_ns).astype(np.float64) * 1e-9
    first_s, last_s = drop.seconds[[0, -1]]
    return int(np.count_nonzero((seconds >= first_s) & (seconds <= last_s)))


def _paper_warnings(drop: Drop) -> list[str]:
    height = drop.release_m - drop.table_m + views.PAPER_RADIUS_M
    low, high = PAPER_HEIGHT_M
    if low - 0.1 <= height <= high + 0.1:
        return []
    return [
        f"a drop from {height:.2f} m (ball of 0.5 m radius) is outside the {low:g} to {high:g} m "
        "that the paper's network was trained on"
    ]
