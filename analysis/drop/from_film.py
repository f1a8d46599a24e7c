"""Drop from pictures: the ball's coefficient of restitution from an uncalibrated video."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from analysis.checks import Check, CrossCheck
from analysis.drop.checks import motion_checks, recording_checks, sure_check
from analysis.drop.cross_checks import flight_cross_check
from analysis.drop.detection import FilmDetection
from analysis.drop.film_checks import film_checks, hop_check, scale_checks, seconds_out_of_view
from analysis.drop.film_parts import FilmPart, parted_film
from analysis.drop.film_presets import PRESETS
from analysis.drop.motion import simulation_fit, tuned_motion
from analysis.drop.placed_pictures import placed_by_motion
from analysis.drop.presets import PAPER_HEIGHT_M
from analysis.drop.problem import drop_problem
from analysis.drop.rebounds import reported_rebounds
from analysis.drop.sound_beside import sound_beside
from analysis.estimators.base import FitResult, Step
from analysis.experiment import Claim
from analysis.selection import Hints, Selection, Subject
from analysis.tracking.pictures import Pictures, one_thread
from analysis.tracking.track import Track, track_ball
from recorders.simulators.balls import completed, contradict, recorded_ball
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.errors import NotFoundError
from tunenet_logs.formats.video import is_rate_said
from tunenet_logs.left_out import NOT_LATER, LeftOut, added

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from analysis.record import Tuning

# Fall times without a sample: an impact may hide in a longer gap, even of few pictures.
_MAX_GAP_FALLS = 0.4

_UNSURE = 0.1  # half width of an interval from which on nothing is reported


class DropFromFilm:
    """See `Experiment`."""

    name = "drop-video"
    kind = "drop"
    occasion = "drop"
    observed = "pictures of a ball"
    takes: frozenset[Subject] = frozenset(("ball", "pictures"))
    presets = PRESETS
    problem = staticmethod(drop_problem)
    motion = staticmethod(tuned_motion)
    rebounds = staticmethod(reported_rebounds)

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim an episode by its pictures; see `Experiment.claim`."""
        topics = episode.picture_topics
        there = bool(topics) if topic is None else topic in topics
        return Claim.PLAINLY if there else Claim.NONE

    def detect(self, episode: Episode, selection: Selection, preset: str) -> FilmDetection:
        """Detect the ball in the pictures of the first camera that shows a drop."""
        topics = episode.picture_topics if selection.topic is None else (selection.topic,)
        physical = PRESETS[preset].physical
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
        from analysis.drop.review.refused import log_refused
        from analysis.drop.review.views import log_drop

        if tuning.detection is None:
            return log_refused(stream, tuning)
        return log_drop(stream, tuning)


def _detect_whole(
    episode: Episode, topic: str, selection: Selection, *, physical: bool
) -> FilmDetection:
    """Detect the ball in one topic's pictures, where there are gaps in one segment of them."""
    film = parted_film(episode, topic)
    if film is None:
        return _detect_in(episode, topic, selection, physical=physical)

    def detect(part: FilmPart) -> FilmDetection:
        found = _detect_in(episode, topic, selection, physical=physical, part=part)
        return replace(found, track_warnings=(film.warning(part), *found.track_warnings))

    return film.first_whole_drop(detect)


def _detect_in(
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
