"""A drop from recorded positions: the ball's coefficient of restitution from its height."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.checks import Check, CrossCheck
from analysis.drop import observations as views
from analysis.drop.bounce_fit import fit_bounce
from analysis.drop.checks import (
    fall_checks,
    fit_check,
    rebound_check,
    recording_checks,
    sure_check,
)
from analysis.drop.detection import DISAGREEMENT, TOO_SHORT, DropDetection, drop_problem
from analysis.drop.free_fall import Drop, find_drops, outliers
from analysis.drop.presets import PAPER_HEIGHT_M, PRESETS
from analysis.drop.record_parts import reported_rebounds, tuned_curves
from analysis.estimators.base import FitResult, Observation, Problem, Step
from analysis.experiment import Claim
from analysis.selection import Selection, check_start
from recorders.simulators.drop import RESTITUTION, TOPIC
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

_AGREEMENT = 0.02
"""Of the restitution: what drag and slope take off the cross-check of a good drop."""

_FIT, _PAPER_FIT = 0.008, 0.03
"""Rms [drop heights] that the tuned curve may be off: ours, and the paper's 60 Hz simulator."""

_REJECT, _REJECT_FITTED = 0.1, 0.15
"""Likewise, from where on nothing is reported. A fitted value allows for the air, which the
simulator that it is compared in has not."""

_NOISE_SHARE = 1.2
"""Of the noise that adds to these limits: what white noise alone hardly exceeds."""

_FARTHEST_M = 1e6
"""A coordinate beyond it is a marker for "none"."""


class DropFromPositions:
    """See `Experiment`."""

    name = "drop"
    kind = "drop"
    occasion = "drop"
    parameters = (RESTITUTION,)
    presets = PRESETS
    curves = staticmethod(tuned_curves)
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
        if selection.ball_options:  # nobody should think that they had an effect
            topics = episode.picture_topics
            there = (
                f"to use its pictures: --topic {topics[0]}" if topics else "it holds no pictures"
            )
            named = ", ".join(selection.ball_options)
            unused.append(f"{named} not used: the log holds the ball's position ({there})")
        for signal in _candidates(episode, selection):
            try:
                check_start(selection.start_s, float(signal.seconds[-1]))
                arrivals = correct_late_stamps(signal.stamps_ns)
                even = replace(signal, stamps_ns=arrivals.stamps_ns)
                detection = _detect_in(even, int(signal.stamps_ns[0]), selection, preset)
                late = arrivals.warnings("samples")
                return replace(detection, warnings=(*detection.warnings, *late, *unused))
            except NotFoundError as reason:
                reasons.append(f"{signal.name}: {reason}")
        raise NotFoundError("; ".join((reasons[0], *unused)))

    def problem(self, detection: DropDetection, initial: Array) -> Problem:
        """See `Experiment.problem`."""

        def exact_fit(start: Array) -> FitResult | None:
            """The bounce in closed form, fitted to all samples."""
            fit = fit_bounce(detection.drop, float(start[0]))
            if fit is None:
                return None
            return FitResult(np.array([fit.restitution]), np.array([fit.interval95]), detail=())

        return drop_problem(detection, initial, exact_fit)

    def checks(
        self, detection: DropDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        assert last.evaluation is not None
        drop, physical = detection.drop, detection.physical
        checks = recording_checks(drop, detection.sideways_m)
        if physical:  # the paper's simulator has a drag of its own
            value = float(last.values[0])
            checks += fall_checks(drop, value)
            checks.append(sure_check(*fit.interval95[0]) if fit else rebound_check(drop, value))
        scale = 1.0 if physical else drop.drop_height_m
        most = (_FIT if physical else _PAPER_FIT) + _NOISE_SHARE * drop.noise_m / drop.drop_height_m
        reject = _REJECT_FITTED if fit else _REJECT
        simulated = last.evaluation.observation
        return (*checks, fit_check(simulated, detection.target, scale, most, reject))

    def cross_check(self, detection: DropDetection, estimate: Array) -> CrossCheck | None:
        """The speeds just after and just before the impact, by the parabolas on either side."""
        value = detection.drop.flight_restitution
        if np.isnan(value) or not detection.physical:
            return None
        margin = _AGREEMENT + 3 * detection.drop.flight_restitution_sd
        agrees = bool(abs(value - estimate[0]) < margin)
        return CrossCheck("speeds at the first impact", value, agrees, DISAGREEMENT)

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
        """See `Experiment.review`."""
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


def _detect_in(signal: Signal, start_ns: int, selection: Selection, preset: str) -> DropDetection:
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
    up, signal, drops = _vertical_drops(signal, start_ns)
    column, _ = _AXES[up]
    drop = drops[0]
    window = slice(drop.first, drop.first + len(drop.seconds))
    target = _VIEWS[preset](drop)
    warnings = [] if up == "+z" else [f"up is {up} in {signal.name}"]
    if len(drops) > 1:
        spans = ", ".join(f"{one.seconds[0]:.2f} to {one.seconds[-1]:.2f} s" for one in drops)
        warnings.append(f"{len(drops)} drops ({spans}); the first is used (see --start, --end)")
    if not PRESETS[preset].physical:
        warnings += _paper_warnings(drop, target)
    return DropDetection(
        physical=PRESETS[preset].physical,
        topic=signal.name,
        drop=drop,
        start_ns=start_ns,
        sideways_m=np.delete(signal.values, column, axis=1)[window],
        target=target,
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


def _paper_warnings(drop: Drop, target: Observation) -> list[str]:
    if np.isnan(target.values).any():
        raise NotFoundError(TOO_SHORT)
    height = drop.release_m - drop.table_m + views.PAPER_RADIUS_M
    low, high = PAPER_HEIGHT_M
    if low - 0.1 <= height <= high + 0.1:
        return []
    return [
        f"a drop from {height:.2f} m (ball of 0.5 m radius) is outside the {low:g} to {high:g} m "
        "that the paper's network was trained on"
    ]


_VIEWS: dict[str, Callable[[Drop], Observation]] = {
    "default": views.canonical,
    "paper": views.paper_heights,
    "paper-code": views.paper_heights,
}
