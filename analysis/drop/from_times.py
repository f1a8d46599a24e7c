"""Drop by its impacts alone: restitution from the ratios of successive flights' durations."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from analysis.checks import Check, CrossCheck
from analysis.drop.remedies import RIGHT_SOUND, RIGHT_TIMES
from analysis.drop.times.checks import ratio_cross_check, times_checks
from analysis.drop.times.detection import (
    MIN_IMPACTS,
    TimesDetection,
    no_times,
    signals_in,
    times_problem,
)
from analysis.drop.times.fit import Rig
from analysis.drop.times.impact_prior import ONSET_JITTER_S
from analysis.drop.times.listened import listened
from analysis.drop.times.motion import heard_motion, heard_rebounds
from analysis.drop.times.posterior import MAX_TIMES
from analysis.estimators.base import FitResult, Step
from analysis.experiment import Claim, Preset
from analysis.selection import Selection, Subject, check_start
from recorders.simulators.balls import completed, recorded_ball
from recorders.simulators.drop import REAL_BALL
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.left_out import LeftOut

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from analysis.record import Tuning

_HIGHEST_M = 100.0  # of a drop that somebody measured


class DropFromTimes:
    """See `Experiment`."""

    name = "drop-times"
    kind = "drop"
    occasion = "drop"
    observed = "times or sound of impacts"
    takes: frozenset[Subject] = frozenset(("ball", "height"))
    presets: ClassVar[dict[str, Preset]] = {"default": Preset(True, REAL_BALL, "fit")}
    problem = staticmethod(times_problem)
    motion = staticmethod(heard_motion)
    rebounds = staticmethod(heard_rebounds)

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim an episode by impact times or sound, where no positions or pictures show more."""
        sounds = [one for one in episode.sound_topics if topic in (None, one)]
        if not signals_in(episode, topic) and not sounds:
            return Claim.NONE
        if topic is not None:
            return Claim.PLAINLY
        more = any(signal.is_position for signal in episode.signals.values())
        return Claim.PERHAPS if more or episode.picture_topics else Claim.PLAINLY

    def detect(self, episode: Episode, selection: Selection, preset: str) -> TimesDetection:  # noqa: ARG002 (there is one)
        """Detect the signal with the most times, else the sound; see `Experiment.detect`."""
        names = signals_in(episode, selection.topic)
        if not names and episode.sound_topics:
            return _heard_in_sound(episode, selection)
        if not names:
            raise no_times(episode, selection.topic)
        signal = episode.signals[names[0]]
        warnings: list[str] = []
        if len(names) > 1:
            others = ", ".join(names[1:4])
            warnings.append(f"{names[0]} is used, not {others} (see --topic)")
        if not len(signal.stamps_ns):
            raise NotFoundError(f"{signal.name}: holds no impact times", RIGHT_TIMES)
        check_start(selection.start_s, float(signal.seconds[-1]))
        begin_s = -np.inf if selection.start_s is None else selection.start_s
        end_s = np.inf if selection.end_s is None else selection.end_s
        times_s = signal.seconds[(signal.seconds >= begin_s) & (signal.seconds <= end_s)]
        if len(times_s) < MIN_IMPACTS:
            raise NotFoundError(
                f"{signal.name}: {len(times_s)} impact times, too few for two whole flights",
                f"at the next drop: record {MIN_IMPACTS} impacts or more",
            )
        if len(times_s) > MAX_TIMES:
            warnings.append(f"the first {MAX_TIMES} of {len(times_s)} times are used (see --start)")
        height_m = selection.height_m
        if signal.counts_frames:
            warnings.append(
                "the clock's rate is not known: the restitution stands without it, speeds do not "
                "(see --fps)"
            )
            if height_m is not None:
                warnings.append("--height not used: without a true clock it tells nothing")
            height_m = None
        _check_height(height_m)
        ball = completed(selection.ball, recorded_ball(episode.info))
        return TimesDetection(
            topic=signal.name,
            start_ns=int(signal.stamps_ns[0]),
            times_s=times_s[:MAX_TIMES],
            rig=Rig(ball.drag_1_m, height_m, not signal.counts_frames),
            ball=ball,
            warnings=tuple(warnings),
            left_out=(LeftOut.of_signal(signal),),
        )

    def checks(
        self, detection: TimesDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        return times_checks(detection, last, fit)

    def cross_check(self, detection: TimesDetection, estimate: Array) -> CrossCheck | None:
        """See `ratio_cross_check`."""
        return ratio_cross_check(detection.heard, float(estimate[0]))

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """See `Experiment.review`."""
        from analysis.drop.review.refused_sound import log_refused_sound
        from analysis.drop.review.refused_times import log_refused_times
        from analysis.drop.review.times import log_times

        if tuning.detection is None or tuning.trace is None:
            return log_refused_times(stream, tuning) or log_refused_sound(stream, tuning)
        return log_times(stream, tuning)


def _check_height(height_m: float | None) -> None:
    if height_m is not None and not 0 < height_m <= _HIGHEST_M:
        raise NotFoundError(f"--height {height_m:g} m is no height of a drop; give it in m")


def _heard_in_sound(episode: Episode, selection: Selection) -> TimesDetection:
    _check_height(selection.height_m)
    heard = listened(episode, selection)
    count = len(heard.knocks)
    if count < MIN_IMPACTS:
        knocks = {0: "no knock is", 1: "1 knock is"}.get(count, f"{count} knocks are")
        raise NotFoundError(
            f"{heard.sound.name}: {knocks} heard, too few for two flights",
            RIGHT_SOUND,
        )
    ball = completed(selection.ball, recorded_ball(episode.info))
    return TimesDetection(
        topic=heard.sound.name,
        start_ns=heard.sound.start_ns,
        times_s=heard.knocks.times_s,
        rig=Rig(ball.drag_1_m, selection.height_m, jitter_s=ONSET_JITTER_S),
        ball=ball,
        warnings=heard.sound.warnings,
        listened=heard,
        left_out=tuple(
            LeftOut.of_channel(one) for one in episode.channels if one.topic == heard.sound.name
        ),
    )
