"""Observe a bouncing ball in three ways: by positions, in a video, by the times of its impacts.

A film with gaps is searched segment by segment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from tunenet_logs.analysis.checks import Check, CrossCheck
from tunenet_logs.analysis.drop import GOOD_DROP, RIGHT_SOUND, RIGHT_TIMES
from tunenet_logs.analysis.drop.audio import sound_beside
from tunenet_logs.analysis.drop.bounce_fit import MIN_SAMPLES
from tunenet_logs.analysis.drop.checks import (
    MIN_SEEN,
    fall_checks,
    film_checks,
    fit_check,
    flight_cross_check,
    hop_check,
    motion_checks,
    ratio_cross_check,
    rebound_check,
    recording_checks,
    scale_checks,
    seconds_out_of_view,
    sure_check,
    times_checks,
)
from tunenet_logs.analysis.drop.detection import DropDetection, FilmDetection
from tunenet_logs.analysis.drop.film import placed_by_motion
from tunenet_logs.analysis.drop.free_flight import Drop
from tunenet_logs.analysis.drop.motion import drop_problem, simulation_fit, tuned_motion
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
    heard_rebounds,
    listened,
    no_times,
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
from tunenet_logs.analysis.record import Rebound
from tunenet_logs.analysis.selection import Hints, Selection, Subject
from tunenet_logs.analysis.tracking.frames import Pictures, one_thread, readable_frames
from tunenet_logs.analysis.tracking.track import Track, track_ball
from tunenet_logs.episode import NOT_LATER, Array, Episode, EpisodeInfo, LeftOut, Signal, added
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.reader import check_start, no_topic
from tunenet_logs.recorders.simulators.ball import REAL_BALL
from tunenet_logs.recorders.simulators.known import completed, contradict, recorded_ball
from tunenet_logs.terminal import listed
from tunenet_logs.timing.arrivals import correct_late_stamps
from tunenet_logs.timing.stamps import Gap, gaps_in_words, noted_gaps, parts_between
from tunenet_logs.video import is_rate_said

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from tunenet_logs.analysis.drop.detection import AnyDetection
    from tunenet_logs.analysis.experiment import Tuning


# ---- Film with gaps: each contiguous segment is searched alone

_MAX_PARTS = 20  # segments that are looked at: a camera that is away so often shows no whole drop
# Fall times before the release, and pictures in them, in which a held ball does not move, while one
# that has bounced before is on its way up.
_HELD_FALLS, _MIN_HELD = 0.8, 3


class FilmPart(NamedTuple):
    """Contiguous segment of pictures between two gaps.

    Attributes:
        first_ns: stamp of the first.
        last_ns: stamp of the last.
        begins_in_gap: whether a gap is before it, not the recording's beginning.
        ends_in_gap: the same of its end.
    """

    first_ns: int
    last_ns: int
    begins_in_gap: bool
    ends_in_gap: bool

    def shows_whole(self, drop: Drop) -> bool:
        """Return whether a drop is seen from its release to the top of the first flight.

        A fall whose beginning is in a gap may be that of a later bounce.
        """
        after = (drop.seconds[-1] - drop.impact_s) / drop.fall_time_s
        before = (drop.release_s - drop.seconds) / drop.fall_time_s
        chosen = (before > 0) & (before < _HELD_FALLS)
        below = 1 - drop.heights_m[chosen] / drop.drop_height_m
        rising = before[chosen] ** 2
        is_held = len(rising) >= _MIN_HELD and bool(np.median(below) < np.median(rising) / 2)
        return (is_held or not self.begins_in_gap) and (after > MIN_SEEN or not self.ends_in_gap)


class PartedFilm(NamedTuple):
    """Contiguous segments of a film, and its gaps.

    Attributes:
        start_ns: stamp of the first picture.
        parts: in order, those of enough pictures for a drop.
        gaps: between them.
    """

    start_ns: int
    parts: tuple[FilmPart, ...]
    gaps: tuple[Gap, ...]

    def first_whole_drop(self, detect: Callable[[FilmPart], FilmDetection]) -> FilmDetection:
        """Detect the drop in the first segment that shows a whole one.

        Raises:
            NotFoundError: none does.
            UsageError: a hint that fits no part.
        """
        reasons: list[NotFoundError | UsageError] = []
        cut: list[FilmPart] = []
        for part in self.parts[:_MAX_PARTS]:
            try:
                found = detect(part)
                is_whole = part.shows_whole(found.drop)
            except (NotFoundError, UsageError) as reason:  # a hint may be for another part
                reasons.append(reason)
                continue
            if is_whole:
                return found
            cut.append(part)
        away = f"the camera was away for {gaps_in_words(self.gaps, self.start_ns)}"
        remedy = "drop it again while the camera's connection holds"
        if cut:
            raise NotFoundError(f"{away}, in the middle of a drop", remedy)
        if reasons and all(isinstance(reason, UsageError) for reason in reasons):
            raise reasons[0]
        why = f" (of the first: {reasons[0]})" if reasons else ""
        raise NotFoundError(f"{away}, and no part between shows a whole drop{why}", remedy)

    def warning(self, part: FilmPart) -> str:
        """Return the warning that only this segment is used."""
        first_s, last_s = ((end - self.start_ns) * 1e-9 for end in part[:2])
        return (
            f"the camera was away for {gaps_in_words(self.gaps, self.start_ns)}: the pictures from "
            f"{first_s:.2f} to {last_s:.2f} s are used (others by --start, --end)"
        )


def parted_film(episode: Episode, topic: str) -> PartedFilm | None:
    """Split a topic's film at the gaps that its recorder noted; None where it has none."""
    gaps = noted_gaps(episode.info.notes)
    if not gaps:
        return None
    stamps_ns = np.array([frame.stamp_ns for frame in readable_frames(episode, topic)], np.int64)
    numbers = parts_between(stamps_ns, gaps)
    last = int(numbers.max(initial=0))
    if not last:
        return None
    inside = (stamps_ns[numbers == number] for number in range(last + 1))
    parts = tuple(
        FilmPart(int(part_ns.min()), int(part_ns.max()), number > 0, number < last)
        for number, part_ns in enumerate(inside)
        if len(part_ns) >= MIN_SAMPLES
    )
    return PartedFilm(int(stamps_ns[0]), parts, gaps)


# ---- Impacts of a drop with their restitution, of films and positions alike


def reported_rebounds(detection: AnyDetection, trace: Trace) -> tuple[Rebound, ...]:
    """Return the impacts that the fit tells apart, else the first by the tuning's restitution."""
    if trace.fit is not None and trace.fit.detail:
        return trace.fit.detail
    ends = None
    if trace.fit is not None:
        low, high = trace.fit.interval95[0].tolist()
        ends = low, high
    drop = detection.drop
    speed_m_s = drop.impact_speed_m_s if detection.tells_speed else None
    return (Rebound(drop.impact_s, float(trace.estimate[0]), ends, speed_m_s),)


# ---- Drop from pictures: the restitution from an uncalibrated video

# Fall times without a sample: an impact may hide in a longer gap, even of few pictures.
_MAX_GAP_FALLS = 0.4

_UNSURE = 0.1  # half width of an interval from which on nothing is reported


class DropFromFilm:
    """See `Experiment`."""

    name = "drop-video"
    kind = "drop"
    occasion = "drop"
    observed = "pictures of a ball"
    accepted_options: frozenset[Subject] = frozenset(("ball", "pictures"))
    presets = FILM_PRESETS
    problem = staticmethod(drop_problem)
    motion = staticmethod(tuned_motion)
    rebounds = staticmethod(reported_rebounds)

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim an episode by its pictures; see `Experiment.claim`."""
        topics = episode.picture_topics
        there = bool(topics) if topic is None else topic in topics
        return Claim.CERTAIN if there else Claim.NONE

    def detect(self, episode: Episode, selection: Selection, preset: str) -> FilmDetection:
        """Detect the ball in the pictures of the first camera that shows a drop."""
        topics = episode.picture_topics if selection.topic is None else (selection.topic,)
        physical = FILM_PRESETS[preset].physical
        with one_thread():
            return self._detect(episode, topics, selection, physical=physical)

    def _detect(
        self, episode: Episode, topics: Sequence[str], selection: Selection, *, physical: bool
    ) -> FilmDetection:
        if len(topics) == 1:
            return _detect_whole(episode, topics[0], selection, physical=physical)
        reasons, remedy = list[str](), ""
        for topic in topics:
            try:
                detection = _detect_whole(episode, topic, selection, physical=physical)
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
        """See `Experiment.checks`."""
        assert last.evaluation is not None
        film, drop = detection.film, detection.drop
        fitted = drop.seconds >= film.fit.samples.seconds[0]
        part = replace(drop, seconds=drop.seconds[fitted], heights_m=drop.heights_m[fitted])
        excused_s = seconds_out_of_view(film)
        excused_s = excused_s[(excused_s > part.seconds[0]) & (excused_s < part.seconds[-1])]
        impacts_s = (
            film.projection.impact_s
            + film.projection.fall_time_s * (film.projection.impacts(float(drop.seconds[-1]))[:2])
        )  # how far it goes after the second one does not touch the first
        sideways_m = detection.sideways_m[fitted]
        if len(impacts_s) > 1:
            sideways_m = sideways_m[part.seconds <= impacts_s[1]]
        checks = [
            Check(
                "pictures as they were recorded",
                not detection.unread,
                detection.unread or "all of them can be read",
                advice="tune the file as it was before it was damaged",
            ),
            *film_checks(film),
            *recording_checks(part, sideways_m, _MAX_GAP_FALLS, excused_s),
        ]
        checks += scale_checks(detection)
        if not detection.physical:  # z and y are not to be compared
            return (*checks, _paper_check(drop.drop_height_m))
        value = float(last.values[0])
        sure = fit and sure_check(*fit.interval95[0], reject=_UNSURE)
        checks.append(sure or hop_check(film, value))
        return (*checks, *motion_checks(simulation_fit(detection, last)))

    def cross_check(self, detection: FilmDetection, estimate: Array) -> CrossCheck | None:
        """See `flight_cross_check`."""
        return flight_cross_check(detection, estimate)

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """See `Experiment.review`."""
        from tunenet_logs.analysis.drop.review.rejected import log_refused
        from tunenet_logs.analysis.drop.review.views import log_drop

        if tuning.detection is None:
            return log_refused(stream, tuning)
        return log_drop(stream, tuning)


def _detect_whole(
    episode: Episode, topic: str, selection: Selection, *, physical: bool
) -> FilmDetection:
    """Detect the ball in one topic's pictures, where there are gaps in one segment of them."""
    film = parted_film(episode, topic)
    if film is None:
        return _detect_in_pictures(episode, topic, selection, physical=physical)

    def detect(part: FilmPart) -> FilmDetection:
        found = _detect_in_pictures(episode, topic, selection, physical=physical, part=part)
        return replace(found, track_warnings=(film.warning(part), *found.track_warnings))

    return film.first_whole_drop(detect)


def _detect_in_pictures(
    episode: Episode,
    topic: str,
    selection: Selection,
    *,
    physical: bool,
    part: FilmPart | None = None,
) -> FilmDetection:
    """Detect the ball in one topic's pictures, or a segment of them, and what is known of it."""
    span_ns = (part.first_ns, part.last_ns) if part else None
    pictures = Pictures(episode, topic, selection.start_s, selection.end_s, span_ns)
    track, warnings = _tracked(pictures, selection.hints, episode.info)
    recorded = recorded_ball(episode.info)
    if contradict(selection.ball, recorded):
        warnings.append(
            f"the log's ball ({recorded.words}) is not the one given ({selection.ball.words})"
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
    ball, is_timed = completed(selection.ball, recorded), not episode.frames_untimed
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


def _tracked(pictures: Pictures, hints: Hints, info: EpisodeInfo) -> tuple[Track, list[str]]:
    """Track the ball by the user's hints, else by the recording's own; return warnings, too."""
    if hints != Hints():
        return track_ball(pictures, hints), []
    marked = _marked(info, pictures)
    try:
        return track_ball(pictures, marked), []
    except NotFoundError:
        if marked == Hints():
            raise
    # Who aimed a camera need not have hit the ball, and cannot mark it again.
    said = "the ball was not found by the mark of its recording, but without it"
    return track_ball(pictures), [said]


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


def _paper_check(height_m: float) -> Check:
    low, high = PAPER_HEIGHT_M
    return Check(
        "as in training",
        low - 1 < height_m < high,  # of the ball's lower edge, and a little more
        f"a fall of {height_m:.2f} m by the clock (wanted: {low - 1:g} to {high:g})",
        advice="use the preset default",
    )


# ---- Drop from recorded positions: the restitution from the ball's height

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
    accepted_options: frozenset[Subject] = frozenset(("ball", "lengths"))
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
        return Claim.POSSIBLE if frames else Claim.CERTAIN

    def detect(self, episode: Episode, selection: Selection, preset: str) -> DropDetection:
        """Detect the first drop of the ball's signal; see `Experiment.detect`."""
        reasons: list[tuple[str, NotFoundError]] = []
        found: DropDetection | None = None
        for signal in _candidates(episode, selection):
            try:
                track_found = _detect_in_positions(episode, signal, selection, preset)
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
        from tunenet_logs.analysis.drop.review.rejected import log_refused_heights
        from tunenet_logs.analysis.drop.review.views import log_drop

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


def _detect_in_positions(
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
    height = drop.release_m - drop.table_m + PAPER_RADIUS_M
    low, high = PAPER_HEIGHT_M
    if low - 0.1 <= height <= high + 0.1:
        return []
    return [
        f"a drop from {height:.2f} m (ball of 0.5 m radius) is outside the {low:g} to {high:g} m "
        "that the paper's network was trained on"
    ]


# ---- Drop by its impacts alone: the restitution from the ratios of successive flights' durations

_HIGHEST_M = 100.0  # of a drop that somebody measured


class DropFromTimes:
    """See `Experiment`."""

    name = "drop-times"
    kind = "drop"
    occasion = "drop"
    observed = "times or sound of impacts"
    accepted_options: frozenset[Subject] = frozenset(("ball", "height"))
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
            return Claim.CERTAIN
        more = any(signal.is_position for signal in episode.signals.values())
        return Claim.POSSIBLE if more or episode.picture_topics else Claim.CERTAIN

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
            rig=DropSetup(ball.drag_1_m, height_m, not signal.counts_frames),
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
        from tunenet_logs.analysis.drop.review.rejected import log_refused_sound, log_refused_times
        from tunenet_logs.analysis.drop.review.views import log_times

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
        rig=DropSetup(ball.drag_1_m, selection.height_m, jitter_s=ONSET_JITTER_S),
        ball=ball,
        warnings=heard.sound.warnings,
        listened=heard,
        left_out=tuple(
            LeftOut.of_channel(one) for one in episode.channels if one.topic == heard.sound.name
        ),
    )
