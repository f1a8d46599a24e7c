"""Observe a bouncing ball in three ways: by positions, in a video, by the times of its impacts."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from tunenet_logs.analysis.checks import Check
from tunenet_logs.analysis.drop import GOOD_DROP, RIGHT_SOUND, RIGHT_TIMES
from tunenet_logs.analysis.drop.audio import sound_beside
from tunenet_logs.analysis.drop.bounce_fit import MIN_SAMPLES
from tunenet_logs.analysis.drop.checks import (
    DROP,
    FILM,
    fall_checks,
    film_checks,
    flight_cross_check,
    hop_check,
    motion_checks,
    paper_fit_check,
    paper_height_check,
    ratio_cross_check,
    rebound_check,
    recording_checks,
    scale_checks,
    seconds_out_of_view,
    sound_checks,
    sure_check,
    times_checks,
)
from tunenet_logs.analysis.drop.detection import DropDetection, FilmDetection
from tunenet_logs.analysis.drop.film import placed_by_motion
from tunenet_logs.analysis.drop.motion import (
    HIGHEST_M,
    drop_problem,
    simulation_fit,
    tuned_motion,
)
from tunenet_logs.analysis.drop.presets import (
    FILM_PRESETS,
    PAPER_HEIGHT_M,
    PAPER_RADIUS_M,
    PRESETS,
)
from tunenet_logs.analysis.drop.times.detection import (
    MIN_IMPACTS,
    TimesDetection,
    heard_motion,
    listened,
    signals_in,
    times_problem,
)
from tunenet_logs.analysis.drop.times.model import MAX_TIMES, DropSetup
from tunenet_logs.analysis.drop.times.readings import ONSET_JITTER_S
from tunenet_logs.analysis.drop.track import (
    PositionTrack,
    is_something_else,
    moves_as_found,
    position_signals,
)
from tunenet_logs.analysis.estimators.base import FitResult, Step, Trace
from tunenet_logs.analysis.experiment import Claim, Preset
from tunenet_logs.analysis.options import Hints, Subject, TuneOptions
from tunenet_logs.analysis.record import Rebound
from tunenet_logs.analysis.tracking.frames import Pictures, one_thread, readable_frames
from tunenet_logs.analysis.tracking.track import track_ball
from tunenet_logs.episode import NOT_LATER, Episode, EpisodeInfo, LeftOut, Signal, added
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.reader import check_start, no_topic
from tunenet_logs.recorders.simulators.ball import REAL_BALL
from tunenet_logs.recorders.simulators.known import completed, contradict, recorded_ball
from tunenet_logs.terminal import listed
from tunenet_logs.timing.arrivals import correct_late_stamps
from tunenet_logs.timing.stamps import gaps_in_words, noted_gaps, parts_between
from tunenet_logs.video import is_rate_said

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from tunenet_logs.analysis.experiment import Tuning


class BallDrop:
    """Base of the ways to see a ball fall and bounce; a subclass makes an `Experiment` of it."""

    kind = "drop"
    occasion = "drop"
    problem = staticmethod(drop_problem)
    motion = staticmethod(tuned_motion)
    cross_check = staticmethod(flight_cross_check)

    def example(self, stream: rr.RecordingStream) -> rrb.View | None:
        """Draw the heights of a good drop."""
        from tunenet_logs.analysis.drop.review.rejected import log_good_drop

        return log_good_drop(stream)

    def rebounds(self, detection: Any, trace: Trace) -> tuple[Rebound, ...]:
        """List the impacts that the fit tells apart, else the first by the tuned restitution."""
        if trace.fit is not None and trace.fit.detail:
            return trace.fit.detail
        ends = None
        if trace.fit is not None:
            low, high = trace.fit.interval95[0].tolist()
            ends = low, high
        drop = detection.drop
        speed_m_s = drop.impact_speed_m_s if detection.tells_speed else None
        return (Rebound(drop.impact_s, float(trace.estimate[0]), ends, speed_m_s),)


# ---- By recorded positions: the restitution from the ball's height


class DropFromPositions(BallDrop):
    """Drop by the height of a ball whose positions were recorded."""

    name = "drop"
    observed = "positions of a ball"
    accepted_options: frozenset[Subject] = frozenset(("ball", "lengths"))
    presets = PRESETS

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim by positions; by mere frames weakly: every robot logs them."""
        signals = episode.signals.values() if topic is None else episode.signals_of(topic)
        positions = [signal.name for signal in signals if signal.is_position]
        if not positions:
            return Claim.NONE
        frames = all(name.startswith("/tf") and "ball" not in name for name in positions)
        return Claim.POSSIBLE if frames else Claim.CERTAIN

    def detect(self, episode: Episode, selection: TuneOptions, preset: str) -> DropDetection:
        """Detect the drop in the first signal that moves as a ball, else in the first that may."""
        topic = selection.topic
        signals = episode.signals.values() if topic is None else episode.signals_of(topic)
        positions = position_signals(signals)
        if not positions and topic is not None:
            usable = {name for name, one in episode.signals.items() if one.is_position}
            raise no_topic(topic, {*usable, *episode.picture_topics, *signals_in(episode, None)})
        if not positions:
            types = (f"{one.topic} ({one.type_name or 'no type'})" for one in episode.channels)
            seen = listed(types, 2)  # it is one line
            raise NotFoundError(
                f"no channel with a ball's position or with pictures (channels: {seen or 'none'})",
                "record one of them, or say which column is which with --columns "
                "(tunenet docs formats)",
            )
        reasons: list[tuple[str, NotFoundError]] = []
        found: DropDetection | None = None
        for signal in positions:
            try:
                track_found = _detect_in_positions(episode, signal, selection, preset)
            except NotFoundError as reason:
                reasons.append((signal.name, reason))
                continue
            found = found or track_found
            if moves_as_found(track_found):
                found = track_found
                break
        if found is not None and not (reasons and is_something_else(found)):
            return found
        name, reason = reasons[0]
        why, source = f"{name}: {reason.what}", episode.info.source
        if len(reasons) > 1:
            why = f"none of {len(reasons)} tracks falls freely and bounces ({why})"
            why = f"{source}: {why}" if source else why
        raise NotFoundError(why, reason.remedy or GOOD_DROP)

    def checks(
        self, detection: DropDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """Check the recording, the fall and the fit."""
        assert last.evaluation is not None
        drop = detection.drop
        checks = recording_checks(
            drop,
            detection.sideways_m,
            0.13 if drop.launched else 0.0,  # fall times on the ground, where no sample is used
            sunk_m=detection.sunk_m,
            # A hand catches a thrown ball before the top of its bounce.
            least_seen=0.2 if drop.launched else None,
        )
        if not detection.physical:  # the paper's simulator has a drag of its own
            return (*checks, paper_fit_check(last.evaluation.observation, detection.target, drop))
        value = float(last.values[0])
        checks += fall_checks(drop, value, detection.units)
        sure = fit and sure_check(*fit.interval95[0], fatal=False)
        checks.append(sure or rebound_check(drop, value))
        heard = sound_checks(detection.ear)
        return (*checks, *motion_checks(simulation_fit(detection, last)), *heard)

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """Send the drop, or the heights in which none was found."""
        from tunenet_logs.analysis.drop.review.rejected import log_refused_heights
        from tunenet_logs.analysis.drop.review.views import log_drop

        return (log_refused_heights if tuning.detection is None else log_drop)(stream, tuning)


def _detect_in_positions(
    episode: Episode, signal: Signal, selection: TuneOptions, preset: str
) -> DropDetection:
    """Detect the drop in one track, with late stamps corrected."""
    check_start(selection.start_s, float(signal.seconds[-1]))
    arrivals = correct_late_stamps(signal.stamps_ns)
    even = replace(signal, stamps_ns=arrivals.stamps_ns)
    ball = completed(selection.given_ball, recorded_ball(episode.info))
    track = PositionTrack(even, int(signal.stamps_ns[0]), PRESETS[preset].physical, ball)
    found = track.part(selection.start_s, selection.end_s).detect()
    warnings = list(found.warnings)
    if found.others and found.posterior is not None:  # thrown again and again: how its bounces vary
        values = [one.restitution for one in found.rebounds]
        speeds = [one.impact_speed_m_s for one in found.rebounds]
        known = [speed for speed in speeds if speed is not None]
        fast = f" at {min(known):.1f} to {max(known):.1f} m/s" if known else ""
        told = f"{len(values)} bounces, {min(values):.3f} to {max(values):.3f}{fast}"
        warnings.append(
            f"{told}; the one at {found.drop.impact_s:.2f} s is the result (see --start)"
        )
    if not found.physical:
        height_m = found.found.release_m - found.found.table_m + PAPER_RADIUS_M
        low, high = PAPER_HEIGHT_M
        if not low - 0.1 <= height_m <= high + 0.1:  # [m], as well as a hand lets go
            warnings.append(
                f"a drop from {height_m:.2f} m (ball of 0.5 m radius) is outside the {low:g} to "
                f"{high:g} m that the paper's network was trained on"
            )
    warnings += arrivals.warnings("samples")
    sound = sound_beside(episode, track.start_ns)
    lacking = (LeftOut.of_signal(signal),)
    return replace(found, warnings=tuple(warnings), sound=sound, left_out=lacking)


# ---- In pictures: the restitution from an uncalibrated video


class DropFromFilm(BallDrop):
    """Drop of a ball that is tracked in an uncalibrated video."""

    name = "drop-video"
    observed = "pictures of a ball"
    accepted_options: frozenset[Subject] = frozenset(("ball", "pictures"))
    presets = FILM_PRESETS

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim an episode by its pictures."""
        topics = episode.picture_topics
        there = bool(topics) if topic is None else topic in topics
        return Claim.CERTAIN if there else Claim.NONE

    def detect(self, episode: Episode, selection: TuneOptions, preset: str) -> FilmDetection:
        """Detect the ball in the pictures of the first camera that shows a drop."""
        topics = episode.picture_topics if selection.topic is None else (selection.topic,)
        physical = FILM_PRESETS[preset].physical
        reasons, remedy = list[str](), ""
        with one_thread():
            if len(topics) == 1:
                return _detect_in_topic(episode, topics[0], selection, physical=physical)
            for topic in topics:
                try:
                    detection = _detect_in_topic(episode, topic, selection, physical=physical)
                    detection.film  # noqa: B018 (only its fit shows whether a camera saw the drop)
                except NotFoundError as reason:
                    reasons.append(f"{topic}: {reason.what}")
                    remedy = remedy or reason.remedy
                else:
                    return detection
        raise NotFoundError("; ".join(reasons), remedy)

    def checks(
        self, detection: FilmDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """Check the pictures, the track, the scale and the fit."""
        assert last.evaluation is not None
        film, drop = detection.film, detection.drop
        fitted = drop.seconds >= film.posterior.fit.samples.seconds[0]
        heights_m = drop.heights_m
        if film.posterior.fit.samples.is_soft:  # squashed, its middle is below
            touches = film.projection.touches(drop.seconds)
            heights_m = np.where(touches, np.maximum(heights_m, drop.contact_m), heights_m)
        part = replace(drop, seconds=drop.seconds[fitted], heights_m=heights_m[fitted])
        excused_s = seconds_out_of_view(film)
        excused_s = excused_s[(excused_s > part.seconds[0]) & (excused_s < part.seconds[-1])]
        # How far it goes after the second impact does not touch the first.
        sideways_m, view = detection.sideways_m[fitted], film.projection
        impacts = view.impacts(float(drop.seconds[-1]))
        if len(impacts) > 1:
            second_s = view.impact_s + view.fall_time_s * impacts[1]
            sideways_m = sideways_m[part.seconds <= second_s]
        # Of the impact's speed, over the whole time: a quarter, as far as it is looked at.
        most_sideways = 0.25 * len(sideways_m) / len(part.seconds)
        least_seen = None
        if view.moves:  # heights alone do not tell a rebound from a way to the side
            least_seen = 0.1 + (2 * view.bounce.restitution if len(impacts) < 2 else impacts[1])
        checks = [
            FILM["pictures as they were recorded"].measured(
                not detection.unread, detail=detection.unread or "all of them can be read"
            ),
            *film_checks(film),
            # An impact may hide in a gap of more than 0.4 fall times, even of few pictures.
            *recording_checks(
                part,
                sideways_m,
                0.4,
                excused_s,
                most_sideways=most_sideways,
                least_seen=least_seen,
            ),
        ]
        checks += scale_checks(detection)
        if not detection.physical:  # z and y are not to be compared
            return (*checks, paper_height_check(drop.drop_height_m))
        value = float(last.values[0])
        sure = fit and sure_check(*fit.interval95[0])
        checks.append(sure or hop_check(film, value))
        heard = sound_checks(detection.ear)
        return (*checks, *motion_checks(simulation_fit(detection, last)), *heard)

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """Send the drop, or the track in which none was found."""
        from tunenet_logs.analysis.drop.review.rejected import log_refused
        from tunenet_logs.analysis.drop.review.views import log_drop

        return (log_refused if tuning.detection is None else log_drop)(stream, tuning)


def _detect_in_topic(
    episode: Episode, topic: str, selection: TuneOptions, *, physical: bool
) -> FilmDetection:
    """Detect the ball in one topic's pictures; of a film with gaps, in the first whole drop.

    Its contiguous parts are searched in turn, the first 20 at most: a camera that is away so often
    shows no whole drop.
    """
    gaps = noted_gaps(episode.info.notes)
    frames = readable_frames(episode, topic) if gaps else ()
    stamps_ns = np.array([frame.stamp_ns for frame in frames], np.int64)
    numbers = parts_between(stamps_ns, gaps)
    last = int(numbers.max(initial=0))
    if not last:
        return _detect_in_pictures(episode, topic, selection, physical=physical)
    start_ns = int(stamps_ns[0])
    away = f"the camera was away for {gaps_in_words(gaps, start_ns)}"
    counts = np.bincount(numbers)
    reasons: list[NotFoundError | UsageError] = []
    is_cut = False
    for number in np.flatnonzero(counts >= MIN_SAMPLES)[:20].tolist():
        part_ns = stamps_ns[numbers == number]
        span_ns = int(part_ns.min()), int(part_ns.max())
        try:
            found = _detect_in_pictures(
                episode, topic, selection, physical=physical, span_ns=span_ns
            )
            drop = found.drop
        except (NotFoundError, UsageError) as reason:  # a hint may be for another part
            reasons.append(reason)
            continue
        # A fall that begins in a gap may be that of a later bounce, unless the ball was held: for
        # 0.8 fall times before, in 3 pictures, it does not move, while one that bounced is rising.
        before = (drop.release_s - drop.seconds) / drop.fall_time_s
        chosen = (before > 0) & (before < 0.8)
        below, rising = 1 - drop.heights_m[chosen] / drop.drop_height_m, before[chosen] ** 2
        is_held = len(rising) >= 3 and bool(np.median(below) < np.median(rising) / 2)
        seen_falls = (drop.seconds[-1] - drop.impact_s) / drop.fall_time_s
        is_seen = seen_falls > DROP["first flight seen"].limit.value
        if (is_held or number == 0) and (is_seen or number == last):
            first_s, last_s = ((end_ns - start_ns) * 1e-9 for end_ns in span_ns)
            warning = (
                f"{away}: the pictures from {first_s:.2f} to {last_s:.2f} s are used (others by "
                "--start, --end)"
            )
            return replace(found, track_warnings=(warning, *found.track_warnings))
        is_cut = True
    remedy = "drop it again while the camera's connection holds"
    if is_cut:
        raise NotFoundError(f"{away}, in the middle of a drop", remedy)
    if reasons and all(isinstance(reason, UsageError) for reason in reasons):
        raise reasons[0]
    why = f" (of the first: {reasons[0]})" if reasons else ""
    raise NotFoundError(f"{away}, and no part between shows a whole drop{why}", remedy)


def _detect_in_pictures(
    episode: Episode,
    topic: str,
    selection: TuneOptions,
    *,
    physical: bool,
    span_ns: tuple[int, int] | None = None,
) -> FilmDetection:
    """Detect the ball in one topic's pictures, or a span of them, and what is known of it."""
    pictures = Pictures(episode, topic, selection.start_s, selection.end_s, span_ns)
    warnings: list[str] = []
    hints = _marked(episode.info, pictures) if selection.hints == Hints() else selection.hints
    try:
        track = track_ball(pictures, hints)
    except NotFoundError:
        if selection.hints != Hints() or hints == Hints():
            raise
        # Who aimed a camera need not have hit the ball, and cannot mark it again.
        track = track_ball(pictures)
        warnings.append("the ball was not found by the mark of its recording, but without it")
    recorded = recorded_ball(episode.info)
    if contradict(selection.given_ball, recorded):
        warnings.append(
            f"the log's ball ({recorded.words}) is not the one given ({selection.given_ball.words})"
        )
    unread = ""
    recorded_count = sum(one.messages for one in episode.channels if one.topic == topic)
    if selection.end_s is None and pictures.opened < recorded_count:
        unread = (
            f"only {pictures.opened} of {recorded_count} pictures can be read: the others are "
            "damaged or a video's whose beginning is missing"
        )
        warnings.append(unread)
    said = {f"{topic}: {words}" for words in pictures.jumps}
    warnings += sorted(said - set(episode.warnings))
    ball, is_timed = completed(selection.given_ball, recorded), not episode.frames_untimed
    track, arrivals = placed_by_motion(
        track, pictures.arrivals, pictures.start_ns, ball if is_timed else None
    )
    warnings += arrivals.warnings("pictures")
    if pictures.other_size:
        warnings.append(f"{pictures.other_size} pictures of another size were left out")
    if pictures.damaged:
        warnings.append(f"{pictures.damaged} damaged pictures were left out")
    lacking = tuple(
        LeftOut(topic, one.used, added(one.by_reason, {NOT_LATER: pictures.not_later}))
        for one in map(LeftOut.of_channel, episode.channels)
        if one.name == topic
    )
    return FilmDetection(
        left_out=lacking,
        physical=physical,
        topic=topic,
        start_ns=pictures.start_ns,
        track=track,
        ball=ball,
        height_m=episode.info.rig.get("drop_height_m"),
        unread=unread,
        taken_ns=arrivals.taken_ns,
        track_warnings=tuple(warnings),
        is_timed=is_timed,
        is_rate_known=is_rate_said(episode.info.notes),
        sound=sound_beside(episode, pictures.start_ns),
    )


def _marked(info: EpisodeInfo, pictures: Pictures) -> Hints:
    """Return the ball as it was marked in the preview of the recording, if it was.

    What was marked before the recording began is looked for at its beginning.
    """
    try:
        x, y = (float(part) for part in info.notes.get("ball_at_px", "").split(","))
        first_ns, last_ns = (int(one) for one in pictures.stamps_ns[[0, -1]])
        at_ns = min(max(int(info.notes["ball_at_stamp_ns"]), first_ns), last_ns)
    except (ValueError, KeyError):
        return Hints()
    wide, tall = pictures.size_px
    inside = 0 <= x < wide and 0 <= y < tall
    at_s = (at_ns - pictures.start_ns) * 1e-9
    return Hints(ball_at=(x, y, at_s)) if inside else Hints()


# ---- By its impacts alone: the restitution from the ratios of successive flights' durations


class DropFromTimes:
    """Drop of a ball that is only heard: by times of its impacts, or a sound."""

    name = "drop-times"
    kind = "drop"
    occasion = "drop"
    observed = "times or sound of impacts"
    accepted_options: frozenset[Subject] = frozenset(("ball", "height"))
    presets: ClassVar[dict[str, Preset]] = {"default": Preset(True, REAL_BALL, "fit")}
    problem = staticmethod(times_problem)
    motion = staticmethod(heard_motion)
    checks = staticmethod(times_checks)
    cross_check = staticmethod(ratio_cross_check)

    def rebounds(self, detection: TimesDetection, trace: Trace) -> tuple[Rebound, ...]:
        """List each impact between two flights that were heard whole; without a fit the first."""
        return detection.heard.rebounds if trace.fit is not None else detection.heard.rebounds[:1]

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim an episode by impact times or sound, where no positions or pictures show more."""
        sounds = [one for one in episode.sound_topics if topic in (None, one)]
        if not signals_in(episode, topic) and not sounds:
            return Claim.NONE
        if topic is not None:
            return Claim.CERTAIN
        more = any(signal.is_position for signal in episode.signals.values())
        return Claim.POSSIBLE if more or episode.picture_topics else Claim.CERTAIN

    def detect(self, episode: Episode, selection: TuneOptions, preset: str) -> TimesDetection:  # noqa: ARG002 (there is one)
        """Detect the signal with the most times, else the sound."""
        names = signals_in(episode, selection.topic)
        if not names and episode.sound_topics:
            return _heard_in_sound(episode, selection)
        if not names:
            known = listed(sorted(signals_in(episode, None)))
            if selection.topic is not None and known:
                what = f"no impact times in topic {selection.topic} (there are: {known})"
                raise NotFoundError(what, "name one of these with --topic, or leave it out")
            raise NotFoundError(
                "no channel with times of impacts; name them: --columns times=COLUMN"
            )
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
        ball = completed(selection.given_ball, recorded_ball(episode.info))
        return TimesDetection(
            topic=signal.name,
            start_ns=int(signal.stamps_ns[0]),
            times_s=times_s[:MAX_TIMES],
            rig=DropSetup(ball.drag_1_m, height_m, not signal.counts_frames),
            ball=ball,
            warnings=tuple(warnings),
            left_out=(LeftOut.of_signal(signal),),
        )

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """Send the impacts, or the times or sound in which no ball was heard."""
        from tunenet_logs.analysis.drop.review.rejected import log_refused_sound, log_refused_times
        from tunenet_logs.analysis.drop.review.views import log_times

        if tuning.detection is None or tuning.trace is None:
            return log_refused_times(stream, tuning) or log_refused_sound(stream, tuning)
        return log_times(stream, tuning)

    example = BallDrop.example


def _check_height(height_m: float | None) -> None:
    if height_m is not None and not 0 < height_m <= HIGHEST_M:
        raise NotFoundError(f"--height {height_m:g} m is no height of a drop; give it in m")


def _heard_in_sound(episode: Episode, selection: TuneOptions) -> TimesDetection:
    _check_height(selection.height_m)
    heard = listened(episode, selection)
    count = len(heard.knocks)
    if count < MIN_IMPACTS:
        knocks = {0: "no knock is", 1: "1 knock is"}.get(count, f"{count} knocks are")
        what = f"{heard.sound.name}: {knocks} heard, too few for two flights"
        raise NotFoundError(what, RIGHT_SOUND)
    ball = completed(selection.given_ball, recorded_ball(episode.info))
    return TimesDetection(
        topic=heard.sound.name,
        start_ns=heard.sound.start_ns,
        times_s=heard.knocks.times_s,
        rig=DropSetup(ball.drag_1_m, selection.height_m, jitter_s=ONSET_JITTER_S),
        ball=ball,
        warnings=heard.sound.warnings,
        listened=heard,
        left_out=tuple(
            LeftOut.of_channel(one) for one in episode.channels if one.topic == heard.sound.name
        ),
    )
