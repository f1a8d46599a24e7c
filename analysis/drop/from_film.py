"""The filmed drop: a ball's coefficient of restitution from an uncalibrated video."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop import observations as views
from analysis.drop.checks import Check, fit_check, recording_checks, sure_check
from analysis.drop.detection import DISAGREEMENT, DropDetection, drop_problem
from analysis.drop.film import FilmedDrop, canonical_film, find_filmed_drop, image_rows
from analysis.drop.film_checks import film_checks, hop_check, scale_checks
from analysis.drop.film_presets import PRESETS
from analysis.drop.film_restitution import film_rebounds, film_value
from analysis.drop.flight_times import flight_ratio
from analysis.drop.presets import PAPER_HEIGHT_M
from analysis.estimators.base import Problem, Step
from analysis.experiment import Claim, CrossCheck, FitResult, Preset, Selection
from analysis.tracking.pictures import Pictures
from analysis.tracking.track import Hints, Track, track_ball
from recorders.simulators.balls import completed, contradict, recorded_ball
from recorders.simulators.drop import RESTITUTION
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.errors import NotFoundError

_AGREEMENT = 0.03
_FIT = 0.015
_MOST_GAP_FALLS = 0.4
_UNSURE = 0.1
_HIGHEST_M = 6.0
_MOST_NAMED = 5
_LEAST_COMPARED = 0.5
"""Fall times of the simulated flight that are held against the film's, at least."""


class DropVideoTask:
    """See `Task`."""

    name = "drop-video"
    kind = "drop"
    occasion = "drop"
    parameters = (RESTITUTION,)

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """By its pictures; see `Task.claim`."""
        topics = episode.picture_topics
        there = bool(topics) if topic is None else topic in topics
        return Claim.PLAINLY if there else Claim.NONE

    @property
    def presets(self) -> Mapping[str, Preset]:
        """See `Task.presets`."""
        return PRESETS

    def find(self, episode: Episode, selection: Selection, preset: str) -> DropDetection:
        """The first drop that pictures show, camera by camera; see `Task.find`."""
        topics = episode.picture_topics if selection.topic is None else (selection.topic,)
        reasons: list[str] = []
        for topic in topics:
            try:
                return self._find_in(episode, topic, selection, preset)
            except NotFoundError as reason:
                reasons.append(str(reason) if len(topics) == 1 else f"{topic}: {reason}")
        raise NotFoundError("; ".join(reasons))

    def _find_in(
        self, episode: Episode, topic: str, selection: Selection, preset: str
    ) -> DropDetection:
        pictures = Pictures(episode, topic, selection.start_s, selection.end_s)
        track, warnings = _tracked(pictures, selection.hints, episode.info)
        recorded = recorded_ball(episode.info)
        ball = completed(selection.ball, recorded)
        if contradict(selection.ball, recorded):
            warnings.append(
                f"the log's ball ({recorded.words}) is not the one told ({selection.ball.words}); "
                "the told one is used"
            )
        selection = replace(selection, ball=ball)
        found = self.find_in_track(track, pictures.start_ns, selection, preset)
        unread = ""
        told = sum(one.messages for one in episode.channels if one.topic == topic)
        if selection.end_s is None and pictures.opened < told:
            unread = (
                f"only {pictures.opened} of {told} pictures can be read: the others are damaged or "
                "a video's whose beginning is missing"
            )
            warnings.append(unread)
        if selection.arm_options:
            warnings.append(f"{', '.join(selection.arm_options)} not used: this is a drop")
        warnings += pictures.arrivals.words("pictures")
        if pictures.other_size:
            warnings.append(f"{pictures.other_size} pictures of another size were left out")
        if pictures.damaged:
            warnings.append(f"{pictures.damaged} damaged pictures were left out")
        return replace(
            found,
            topic=topic,
            unread=unread,
            taken_ns=pictures.arrivals.taken_ns,
            warnings=(*warnings, *found.warnings),
            known_m=(ball.diameter_m, episode.info.rig.get("drop_height_m")),
        )

    def find_in_track(
        self, track: Track, start_ns: int, selection: Selection, preset: str
    ) -> DropDetection:
        """The first drop in a track, whose clock is 0 at `start_ns`; see `Task.find`."""
        film = find_filmed_drop(track, start_ns, selection.ball, fit_drag=selection.fit_drag)
        physical = PRESETS[preset].physical
        return DropDetection(
            physical=physical,
            topic="",
            drop=film.drop,
            start_ns=start_ns,
            sideways_m=film.sideways[:, None] * film.drop.drop_height_m,
            target=canonical_film(film) if physical else _paper_target(film),
            warnings=(_warnings if physical else _paper_warnings)(film, selection),
            film=film,
            known_m=(selection.ball.diameter_m, None),
        )

    def problem(self, found: DropDetection, initial: Array) -> Problem:
        """See `Task.problem`."""
        return drop_problem(found, initial)

    def refine(self, found: DropDetection, estimate: Array) -> FitResult | None:
        """The bounce in closed form through a projective camera; see `Task.refine`."""
        if not found.physical:
            return None
        assert found.film is not None
        value = film_value(found.film, float(estimate[0]))
        return FitResult(
            values=np.array([value.restitution]),
            interval95=np.array([value.interval95]),
            check=sure_check(*value.interval95, reject=_UNSURE),
            rebounds=film_rebounds(value),
        )

    def checks(
        self, found: DropDetection, last: Step, refined: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Task.checks`."""
        assert last.evaluation is not None
        assert found.film is not None
        fitted = found.drop.seconds >= found.film.best.samples.seconds[0]
        drop = replace(
            found.drop,
            seconds=found.drop.seconds[fitted],
            heights_m=found.drop.heights_m[fitted],
        )
        checks = recording_checks(drop, found.sideways_m[fitted], _MOST_GAP_FALLS)
        checks.append(_read_check(found.unread))
        checks += film_checks(found.film)
        checks += scale_checks(found.film, *found.known_m)
        if not found.physical:  # z and y are not to be compared
            return (*checks, _paper_check(found.drop.drop_height_m))
        value = float(last.values[0])
        checks.append(refined.check if refined else hop_check(found.film, value))
        first = found.target.axis < max(2 * value, _LEAST_COMPARED)
        most = _FIT + 2 * found.film.projection.residual_px / found.film.projection.span_px
        simulated, seen = (_only(one, first) for one in (last.evaluation.observation, found.target))
        return (*checks, fit_check(simulated, seen, 1.0, most))

    def cross_check(self, found: DropDetection, estimate: Array) -> CrossCheck | None:
        """How much shorter the second flight is than the first, which no projection changes."""
        assert found.film is not None
        ratio = flight_ratio(found.film.best) if found.physical else None
        if ratio is None:
            return None
        agrees = abs(ratio.value - ratio.fitted) < _AGREEMENT + 3 * ratio.sd
        # What they tell is the second impact's; the first one's is as much off, at any slope.
        value = float(estimate[0]) * ratio.value / ratio.fitted
        method = "durations of the first two flights"
        return CrossCheck(method, value, bool(agrees), DISAGREEMENT)


def _only(observation: views.Observation, chosen: NDArray[np.bool_]) -> views.Observation:
    """A part of an observation."""
    return replace(observation, values=observation.values[chosen], axis=observation.axis[chosen])


def _tracked(pictures: Pictures, hints: Hints, info: EpisodeInfo) -> tuple[Track, list[str]]:
    """The track by the user's hints, else by the recording's own, and what to say of it."""
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
    """The ball as it was marked in the preview of the recording, if it was.

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


def _paper_target(film: FilmedDrop) -> views.Observation:
    target = image_rows(film, views.paper_start_s(film.drop))
    if np.isnan(target.values).any():
        raise NotFoundError(
            "the paper's network needs 400 samples at 60 Hz: record 6.7 s from the release on, "
            "or use --preset default"
        )
    return target


def _read_check(unread: str) -> Check:
    return Check(
        "pictures as they were recorded",
        not unread,
        unread or "all of them can be read",
        advice="tune the file as it was before it was damaged",
    )


def _paper_check(height_m: float) -> Check:
    low, high = PAPER_HEIGHT_M
    return Check(
        "as in training",
        low - 1 < height_m < high,  # of the ball's lower edge, and a little more
        f"a fall of {height_m:.2f} m by the clock (wanted: {low - 1:g} to {high:g})",
        advice="use the preset default",
    )


def _warnings(film: FilmedDrop, selection: Selection) -> tuple[str, ...]:
    found: list[str] = []
    last = float(film.projection.fall_times(film.drop.seconds[-1:])[0])
    starts, _ = film.projection.bounce.flights(last)
    if selection.fit_drag and (len(starts) < 2 or starts[1] > last):
        found.append("one flight tells little of the air's drag: film more bounces, or --ball NAME")
    if film.later_s:
        at = ", ".join(f"{one:.2f} s" for one in film.later_s[:_MOST_NAMED])
        found.append(f"more drops seem to follow, at {at}; the first is used (see --start, --end)")
    height_m = film.drop.drop_height_m
    if height_m < _HIGHEST_M:
        return tuple(found)
    return (
        *found,
        f"falls {height_m:.1f} m by the clock: slow motion? the restitution is the same; for true "
        "heights and speeds record it with tunenet-record --camera FILE --fps RATE",
    )


def _paper_warnings(film: FilmedDrop, selection: Selection) -> tuple[str, ...]:
    told = (
        f"a fall of {film.drop.drop_height_m:.2f} m by this camera; the paper's network was "
        "trained on a ball of 0.5 m radius falling from 4 to 5 m, before the paper's cameras"
    )
    if selection.fit_drag or selection.ball.drag_1_m is not None:
        return told, "the ball's mass and size, --fit-drag not used: the paper's network has no air"
    return (told,)
