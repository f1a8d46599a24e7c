"""Drop from recorded positions: the ball's coefficient of restitution from its height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

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
from analysis.drop.detection import DropDetection
from analysis.drop.free_fall import Drop
from analysis.drop.motion import simulation_fit, tuned_motion
from analysis.drop.presets import PAPER_HEIGHT_M, PRESETS
from analysis.drop.problem import drop_problem
from analysis.drop.rebounds import reported_rebounds
from analysis.drop.recorded_height import position_signals
from analysis.drop.remedies import GOOD_DROP
from analysis.drop.sound_beside import sound_beside
from analysis.drop.times.detection import signals_in
from analysis.drop.track_search import PositionTrack, is_something_else, moves_as_found
from analysis.estimators.base import FitResult, Step
from analysis.experiment import Claim
from analysis.selection import Selection, Subject, check_start, no_topic
from recorders.simulators.balls import completed, recorded_ball
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.late_stamps import correct_late_stamps
from tunenet_logs.left_out import LeftOut
from tunenet_logs.terminal import listed

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from analysis.record import Tuning

# Rms [drop heights] that the paper's 60 Hz simulator may be off, and how much of the noise adds to
# it: what white noise alone hardly exceeds.
_PAPER_FIT, _NOISE_SHARE = 0.03, 1.2


# Fall times for which a thrown ball is on the ground: no sample of it is used there.
_MAX_TOUCH_FALLS = 0.13

# Of the impact's speed: a ball that rolls off an edge goes sideways by some of it.
_MAX_SIDEWAYS = 0.5


class DropFromPositions:
    """See `Experiment`."""

    name = "drop"
    kind = "drop"
    occasion = "drop"
    observed = "positions of a ball"
    takes: frozenset[Subject] = frozenset(("ball", "lengths"))
    presets = PRESETS
    problem = staticmethod(drop_problem)
    motion = staticmethod(tuned_motion)
    rebounds = staticmethod(reported_rebounds)

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim by positions, mere frames weakly: every robot logs them; see `Experiment.claim`."""
        signals = episode.signals.values() if topic is None else episode.signals_of(topic)
        positions = [signal.name for signal in signals if signal.is_position]
        if not positions:
            return Claim.NONE
        frames = all(name.startswith("/tf") and "ball" not in name for name in positions)
        return Claim.PERHAPS if frames else Claim.PLAINLY

    def detect(self, episode: Episode, selection: Selection, preset: str) -> DropDetection:
        """Detect the first drop of the ball's signal; see `Experiment.detect`."""
        reasons: list[tuple[str, NotFoundError]] = []
        found: DropDetection | None = None
        for signal in _candidates(episode, selection):
            try:
                track_found = _detect_in(episode, signal, selection, preset)
            except NotFoundError as reason:
                reasons.append((signal.name, reason))
                continue
            found = found or track_found
            if moves_as_found(track_found):
                found = track_found
                break
        if found is None or (reasons and is_something_else(found)):
            why = _why_none(episode, reasons)
            raise NotFoundError(why, reasons[0][1].remedy or GOOD_DROP)
        return found

    def checks(
        self, detection: DropDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        assert last.evaluation is not None
        drop = detection.drop
        checks = recording_checks(
            drop,
            detection.sideways_m,
            _MAX_TOUCH_FALLS if drop.launched else 0.0,
            most_sideways=_MAX_SIDEWAYS,
            sunk_m=detection.sunk_m,
        )
        if not detection.physical:  # the paper's simulator has a drag of its own
            most = _PAPER_FIT + _NOISE_SHARE * drop.noise_m / drop.drop_height_m
            simulated = last.evaluation.observation
            return (*checks, fit_check(simulated, detection.target, drop.drop_height_m, most))
        value = float(last.values[0])
        checks += fall_checks(drop, value, detection.units)
        checks.append(sure_check(*fit.interval95[0]) if fit else rebound_check(drop, value))
        return (*checks, *motion_checks(simulation_fit(detection, last)))

    def cross_check(self, detection: DropDetection, estimate: Array) -> CrossCheck | None:
        """See `flight_cross_check`."""
        return flight_cross_check(detection, estimate)

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """See `Experiment.review`."""
        from analysis.drop.review.refused_heights import log_refused_heights
        from analysis.drop.review.views import log_drop

        if tuning.detection is None:
            return log_refused_heights(stream, tuning)
        return log_drop(stream, tuning)


_FEW_TYPES = 2  # channels that are listed with their types where none is of use: it is one line


def _candidates(episode: Episode, selection: Selection) -> list[Signal]:
    """Return the position signals in the order in which to try them."""
    if selection.topic is not None:
        positions = position_signals(episode.signals_of(selection.topic))
        if not positions:
            usable = {name for name, one in episode.signals.items() if one.is_position}
            heard = signals_in(episode, None)
            raise no_topic(selection.topic, {*usable, *episode.picture_topics, *heard})
    else:
        positions = position_signals(episode.signals.values())
    if not positions:
        types = (f"{one.topic} ({one.type_name or 'no type'})" for one in episode.channels)
        seen = listed(types, _FEW_TYPES)
        raise NotFoundError(
            f"no channel with a ball's position or with pictures (channels: {seen or 'none'})",
            "record one of them, or say which column is which with --columns (docs/formats.md)",
        )
    return positions


def _detect_in(
    episode: Episode, signal: Signal, selection: Selection, preset: str
) -> DropDetection:
    """Detect the drop in one track, with late stamps corrected."""
    check_start(selection.start_s, float(signal.seconds[-1]))
    arrivals = correct_late_stamps(signal.stamps_ns)
    even = replace(signal, stamps_ns=arrivals.stamps_ns)
    ball = completed(selection.ball, recorded_ball(episode.info))
    track = PositionTrack(even, int(signal.stamps_ns[0]), PRESETS[preset].physical, ball)
    found = track.part(selection.start_s, selection.end_s).detect()
    papers = () if found.physical else _paper_warnings(found.found)
    late = arrivals.warnings("samples")
    warnings = (*found.warnings, *_spread(found), *papers, *late)
    sound = sound_beside(episode, track.start_ns)
    lacking = (LeftOut.of_signal(signal),)
    return replace(found, warnings=warnings, sound=sound, left_out=lacking)


def _spread(found: DropDetection) -> list[str]:
    """Describe how much the bounces of a ball differ that was thrown again and again."""
    if not found.others or found.posterior is None:
        return []
    values = [one.restitution for one in found.rebounds]
    speeds = [one.impact_speed_m_s for one in found.rebounds if one.impact_speed_m_s is not None]
    fast = f" at {min(speeds):.1f} to {max(speeds):.1f} m/s" if speeds else ""
    told = f"{len(values)} bounces, {min(values):.3f} to {max(values):.3f}{fast}"
    return [f"{told}; the one at {found.drop.impact_s:.2f} s is the result (see --start)"]


def _why_none(episode: Episode, reasons: Sequence[tuple[str, NotFoundError]]) -> str:
    """Explain that none of the tracks is a ball's that bounces, and what the file is."""
    name, reason = reasons[0]
    first = f"{name}: {reason.what}"
    if len(reasons) == 1:
        return first
    tracks = f"none of {len(reasons)} tracks falls freely and bounces ({first})"
    return f"{episode.info.source}: {tracks}" if episode.info.source else tracks


def _paper_warnings(drop: Drop) -> list[str]:
    """Return the warnings of a drop to users of the paper's networks."""
    height = drop.release_m - drop.table_m + views.PAPER_RADIUS_M
    low, high = PAPER_HEIGHT_M
    if low - 0.1 <= height <= high + 0.1:
        return []
    return [
        f"a drop from {height:.2f} m (ball of 0.5 m radius) is outside the {low:g} to {high:g} m "
        "that the paper's network was trained on"
    ]
