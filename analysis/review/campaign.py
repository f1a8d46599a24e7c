"""Review of a campaign in Rerun: an overview that leads to each attempt.

Three timelines step through the attempts, play all drops as one film, and go by wall clock. A view
has a row, maybe an empty one, where an attempt or a drop begins: so it never shows another's data.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tunenet_logs.analysis.campaign import (
    Attempt,
    BallRestitutions,
    Campaign,
    Rate,
    TunedDrop,
    ball_rates,
    overall_rates,
    restitutions_by_ball,
)
from tunenet_logs.analysis.planning import ExpectedShot
from tunenet_logs.analysis.presentation import markdown_table
from tunenet_logs.analysis.result_files import subject_of
from tunenet_logs.analysis.review import drawing as draw
from tunenet_logs.episode import Array
from tunenet_logs.outcomes import BOUNCE_SHOT
from tunenet_logs.recorders.simulators.shot import Hoop
from tunenet_logs.terminal import one_line, short_name

# ---- Timelines: by attempt, as one film of all drops, by wall clock.

ATTEMPT = "attempt"  # the timeline that is stepped through: 1, 2, ..
FILM = "film_s"  # the timeline that plays: all drops one after the other [s]
WALL = "wall_clock"  # the timeline of recording; attempts whose clock is unknown are not on it
# On `FILM`, of a tuning, a shot and an outcome, one after the other: each can be followed.
_STEP_S = 1.0


@dataclass(frozen=True, eq=False)
class Shown:
    """One drop in the film."""

    attempt: Attempt
    drop: TunedDrop
    start_s: float  # where it begins on `FILM`
    zero_s: float  # first time of its own clock that is shown
    end_s: float  # where it ends on `FILM`

    def wall_ns(self, second: float) -> int:
        """Convert a time of the drop's own clock, if a wall clock's, to `WALL`."""
        assert self.drop.wall_ns is not None
        return self.drop.wall_ns + round(second * 1e9)

    @property
    def begin_ns(self) -> int | None:
        """Where it begins on `WALL`; None if its clock is no wall clock."""
        return None if self.drop.wall_ns is None else self.wall_ns(self.zero_s)


@dataclass(frozen=True, eq=False)
class Slot:
    """One attempt in the film."""

    attempt: Attempt
    drops: tuple[Shown, ...]  # in their order
    start_s: float  # where it begins on `FILM`
    tuned_s: float  # where its drops end on `FILM`
    begin_ns: int | None  # where it begins on `WALL`; None if nothing of it has a wall clock

    @property
    def end_s(self) -> float:
        """Where the next attempt begins on `FILM`."""
        return self.tuned_s + 4 * _STEP_S

    @property
    def used(self) -> Shown | None:
        """The drop that the shot was tuned from, or the last that was tried."""
        return self.drops[-1] if self.drops else None

    def is_on_wall(self, shown: Shown) -> bool:
        """Return whether one of its drops happened on `WALL` within this attempt."""
        if shown.begin_ns is None or self.begin_ns is None:
            return False
        return shown.begin_ns >= self.begin_ns

    def drop_ns(self, shown: Shown | None) -> int | None:
        """Return where one of its drops is on `WALL`: where it happened, else where this begins."""
        return shown.begin_ns if shown and self.is_on_wall(shown) else self.begin_ns


def slots_of(attempts: Sequence[Attempt]) -> tuple[Slot, ...]:
    """Lay out the attempts one after the other."""
    slots: list[Slot] = []
    begun: set[int] = set()
    at_s = 0.0
    for attempt in attempts:
        start_s = at_s
        shown: list[Shown] = []
        for drop in attempt.drops:
            # First and last time of a drop's visible data, on its own clock [s].
            times: list[float] = []
            for part in (drop.overlay, drop.film):
                if part is not None:
                    times += (float(part.seconds[0]), float(part.seconds[-1]))
            # On `FILM`, of a drop without curves and pictures: enough to read what it was [s]
            first_s, last_s = (min(times), max(times)) if times else (0.0, 2.0)
            shown.append(Shown(attempt, drop, at_s, first_s, at_s + last_s - first_s))
            at_s = shown[-1].end_s
        # Its first drop's beginning; its end if another attempt began with that drop.
        known = [drop.begin_ns for drop in shown if drop.begin_ns is not None]
        ended_ns = (attempt.outcome and attempt.outcome.stamp_ns) or None
        begin_ns = (
            min(known) if known and (min(known) not in begun or ended_ns is None) else ended_ns
        )
        begun |= set() if begin_ns is None else {begin_ns}
        slots.append(Slot(attempt, tuple(shown), start_s, at_s, begin_ns))
        at_s = slots[-1].end_s
    return tuple(slots)


# What is shown from a moment on: an attempt, and which of its drops; None where it has none.
Begun = tuple[Slot, Shown | None]


def beginnings(slots: Sequence[Slot]) -> list[tuple[str, rr.TimeColumn, list[Begun]]]:
    """Return each timeline's name, its index, and what begins at each row.

    On `ATTEMPT` these are the attempts, each with its last drop; on the others every drop. A view
    with a row, maybe an empty one, at each of them never shows another's data. `WALL` is left out
    without a wall clock.
    """
    steps: dict[int, Begun] = {slot.attempt.number: (slot, slot.used) for slot in slots}
    played: dict[float, Begun] = {}
    clock: dict[int, Begun] = {}
    for slot in slots:
        for shown in slot.drops or (None,):
            played[slot.start_s if shown is None else shown.start_s] = slot, shown
            if (begin_ns := slot.drop_ns(shown)) is not None:
                clock[begin_ns] = slot, shown
    found = [
        (ATTEMPT, rr.TimeColumn(ATTEMPT, sequence=list(steps)), list(steps.values())),
        (FILM, rr.TimeColumn(FILM, duration=list(played)), list(played.values())),
    ]
    if clock:
        found.append((WALL, wall_column(list(clock)), list(clock.values())))
    return found


def log_begun(
    stream: rr.RecordingStream,
    slots: Sequence[Slot],
    entity: str,
    style: Any,
    columns_of: Callable[[str, list[Begun]], Any],
) -> None:
    """Log an entity's style, and the columns of what begins at each row of each timeline.

    `columns_of` gets the timeline's name; it returns None to leave that out.
    """
    stream.log(entity, style, static=True)
    for name, index, begun in beginnings(slots):
        if (columns := columns_of(name, begun)) is not None:
            stream.send_columns(entity, indexes=[index], columns=columns)


def log_gone(
    stream: rr.RecordingStream,
    slots: Sequence[Slot],
    entity: str,
    style: Any,
    timelines: Sequence[str],
) -> None:
    """Log the style of points that move, and that they are gone at each row of some timelines."""
    empty = rr.Points2D.columns(positions=np.zeros((0, 2)))
    log_begun(
        stream,
        slots,
        entity,
        style,
        lambda name, begun: empty.partition([0] * len(begun)) if name in timelines else None,
    )


def moments(slot: Slot, shown: Shown, seconds: Sequence[float]) -> list[rr.TimeColumn]:
    """Return indexes at times of a drop's own clock, on each timeline that plays it."""
    film_s = [shown.start_s + second - shown.zero_s for second in seconds]
    found = [rr.TimeColumn(FILM, duration=film_s)]
    if slot.is_on_wall(shown):
        found.append(wall_column([shown.wall_ns(second) for second in seconds]))
    return found


def wall_column(stamps_ns: Sequence[int]) -> rr.TimeColumn:
    """Return the index of rows at these times on `WALL`."""
    return rr.TimeColumn(WALL, timestamp=np.array(stamps_ns, "datetime64[ns]"))


# ---- Images of the drop under the cursor; a blank one for an attempt without.


_PICTURES = "film/picture"


def log_films(stream: rr.RecordingStream, slots: Sequence[Slot]) -> rrb.View | None:
    """Log the drops' images, and return their view; None without any.

    An attempt without images has a blank one: after an empty row, as after a `Clear`, Rerun 0.41
    goes on showing the last image wherever its chunk has more timelines than the row.
    """
    films = [shown.drop.film for slot in slots for shown in slot.drops if shown.drop.film]
    if not films:
        return None
    blank = draw.blank_picture(films[0].size_px, "no video")
    log_begun(
        stream,
        slots,
        _PICTURES,
        rr.EncodedImage.from_fields(media_type="image/jpeg"),
        lambda name, begun: rr.EncodedImage.columns(
            blob=[_first(name, one, blank) for one in begun]
        ),
    )
    for slot in slots:
        for shown in slot.drops:
            film = shown.drop.film
            if film is not None:
                indexes = moments(slot, shown, film.seconds)
                columns = rr.EncodedImage.columns(blob=list(film.pictures))
                stream.send_columns(_PICTURES, indexes=indexes, columns=columns)
    title = "video (on film_s)"
    return rrb.Spatial2DView(origin="/film", name=title, background=draw.GROUND)


def _first(timeline: str, begun: Begun, blank: bytes) -> bytes:
    """Return a drop's first image on timelines that play it, else its strobe image."""
    slot, shown = begun
    if shown is None or shown.drop.film is None:
        return blank
    does_play = timeline != ATTEMPT and (timeline != WALL or slot.is_on_wall(shown))
    return shown.drop.film.pictures[0] if does_play else shown.drop.film.strobe


# ---- Curves of the drop under the cursor, observed and tuned, or why it has none.


_TUNED: draw.Color = (255, 165, 40)
_OVERLAY_WIDTH = 1.9  # of the chart of curves, in its heights: about the shape of its view


class _CurveAxes(NamedTuple):
    """Range of the chart: seconds from a drop's first impact, and height [m]."""

    begin_s: float
    span_s: float
    top_m: float

    def x(self, seconds: Any) -> Any:
        """Map seconds from the first impact to places in the chart."""
        return (seconds - self.begin_s) / self.span_s * _OVERLAY_WIDTH

    def points(self, drop: TunedDrop, heights_m: Array) -> Array:
        """Map a curve's heights, shape (T,), to points in the chart, shape (T, 2)."""
        return np.column_stack([self.x(_since_impact_s(drop)), -heights_m / self.top_m])


def _since_impact_s(drop: TunedDrop) -> Array:
    """Return the times of a drop's curves from its first impact, where it is known [s]."""
    assert drop.overlay is not None
    zero_s = drop.overlay.seconds[0] if drop.impact_s is None else drop.impact_s
    return drop.overlay.seconds - zero_s


def log_overlays(stream: rr.RecordingStream, slots: Sequence[Slot]) -> rrb.View:
    """Log each drop's observed and tuned height, or why it has none; return the view."""
    curved = [shown.drop for slot in slots for shown in slot.drops if shown.drop.overlay]
    overlays = [drop.overlay for drop in curved if drop.overlay]
    axes = _CurveAxes(0.0, 1.0, 1.0)
    if overlays:
        begin_s = min(float(_since_impact_s(drop)[0]) for drop in curved)
        span_s = max(float(_since_impact_s(drop)[-1]) for drop in curved) - begin_s
        top_m = max(float(np.nanmax(overlay.observed_m, initial=0.0)) for overlay in overlays)
        axes = _CurveAxes(begin_s, max(span_s, 1e-3), max(1.02 * top_m, 1e-3))
    rows = [(-height / axes.top_m, f"{height:g} m") for height in draw.ticks(0.0, axes.top_m)]
    marks = [
        (axes.x(second), f"{second:g} s")
        for second in draw.ticks(axes.begin_s, axes.begin_s + axes.span_s)
    ]
    draw.log_grid(stream, "sheets/overlay", _OVERLAY_WIDTH, rows, marks)
    # All drops of the campaign lie behind, faint.
    drops = [shown.drop for slot in slots for shown in slot.drops]
    every = rr.LineStrips2D(
        [points for points in (_curves(drop, axes)[0] for drop in drops) if len(points) > 1],
        colors=[(*draw.MUTED, 110)],
        radii=draw.screen_radius(0.4),
        draw_order=10.0,
    )
    stream.log("sheets/overlay/every", every, static=True)

    # A row per drop; an empty one clears the last drop's curve.
    def dots(_: str, begun: list[Begun]) -> Any:
        drops = [shown.drop if shown else None for _, shown in begun]
        observed = [_curves(drop, axes)[0] for drop in drops]
        colors = [
            draw.FAILURE if drop is not None and drop.verdict == "rejected" else draw.OBSERVED
            for drop, points in zip(drops, observed, strict=True)
            for _ in points
        ]
        columns = rr.Points2D.columns(positions=np.concatenate(observed), colors=colors)
        return columns.partition([len(points) for points in observed])

    def lines(_: str, begun: list[Begun]) -> Any:
        curves = [_curves(shown.drop if shown else None, axes)[1] for _, shown in begun]
        columns = rr.LineStrips2D.columns(strips=[strip for strips in curves for strip in strips])
        return columns.partition([len(strips) for strips in curves])

    def words(_: str, begun: list[Begun]) -> Any:
        texts = [_no_curve_words(shown.drop if shown else None) for _, shown in begun]
        told = [text for text in texts if text]
        middle = [[_OVERLAY_WIDTH / 2, -0.75]] * len(told)
        columns = rr.Points2D.columns(positions=middle, labels=told)
        return columns.partition([1 if text else 0 for text in texts])

    style = rr.Points2D.from_fields(radii=draw.screen_radius(1.6))
    log_begun(stream, slots, "sheets/overlay/observed", style, dots)
    style = rr.LineStrips2D.from_fields(
        colors=[_TUNED], radii=draw.screen_radius(0.8), draw_order=25.0
    )
    log_begun(stream, slots, "sheets/overlay/simulated", style, lines)
    style = rr.Points2D.from_fields(
        colors=[draw.MUTED], radii=draw.screen_radius(0.1), show_labels=True
    )
    log_begun(stream, slots, "sheets/overlay/words", style, words)
    _log_now(stream, slots, axes)
    title = "drop: observed dots, tuned line, all drops faint"
    return draw.chart_view("overlay", title, _OVERLAY_WIDTH)


def _curves(drop: TunedDrop | None, axes: _CurveAxes) -> tuple[Array, list[Array]]:
    """Return the known samples, and the contiguous segments of the line, shape (T, 2) each."""
    if drop is None or drop.overlay is None:
        return np.zeros((0, 2)), []
    seen = axes.points(drop, drop.overlay.observed_m)
    line = axes.points(drop, drop.overlay.simulated_m)
    parts = np.split(line, np.flatnonzero(np.diff(np.isfinite(line[:, 1]))) + 1)
    known = [one for one in parts if len(one) > 1 and np.isfinite(one[0, 1])]
    return seen[np.isfinite(seen[:, 1])], known


def _no_curve_words(drop: TunedDrop | None) -> str:
    """Say shortly why a drop has no curve; "" if it has one."""
    if drop is None:
        return "no drop was recorded for this attempt"
    said = "this drop was rejected" if drop.verdict == "rejected" else "its tuning holds none"
    return "" if drop.overlay is not None else f"no curve: {said}"


def _log_now(stream: rr.RecordingStream, slots: Sequence[Slot], axes: _CurveAxes) -> None:
    """Log a dot that moves along the curves while the drops play."""
    entity = "sheets/overlay/now"
    style = rr.Points2D.from_fields(
        colors=[draw.OBSERVED], radii=draw.screen_radius(5.0), draw_order=30.0
    )
    log_gone(stream, slots, entity, style, (FILM, WALL))
    for slot in slots:
        for shown in slot.drops:
            overlay = shown.drop.overlay
            if overlay is None:
                continue
            # Samples for one place of the moving dot: still smooth, and the file stays small
            seen = np.flatnonzero(np.isfinite(overlay.observed_m))[::3]
            indexes = moments(slot, shown, overlay.seconds[seen].tolist())
            points = axes.points(shown.drop, overlay.observed_m)[seen]
            columns = rr.Points2D.columns(positions=points)
            stream.send_columns(entity, indexes=indexes, columns=columns)


# ---- Attempt under the cursor: its drop's curves, its images, and facts.


def log_attempts(
    stream: rr.RecordingStream, slots: Sequence[Slot], campaign: Campaign
) -> rrb.Container:
    """Log each attempt's curves, its shot and images if any has them, and facts; lay them out."""
    views = [
        (log_overlays(stream, slots), 4.4),
        (log_shots(stream, slots, campaign), 3.2),
        (log_films(stream, slots), 2.2),
    ]
    log_begun(
        stream,
        slots,
        "attempt",
        rr.TextDocument.from_fields(media_type="text/markdown"),
        lambda _, begun: rr.TextDocument.columns(
            text=[
                attempt_words(slot.attempt, campaign.shots.get(slot.attempt.number))
                for slot, _ in begun
            ]
        ),
    )
    views.append((rrb.TextDocumentView(origin="/attempt", name="the attempt"), 3.2))
    shown = [(view, share) for view, share in views if view is not None]
    return rrb.Horizontal(*(view for view, _ in shown), column_shares=[share for _, share in shown])


def attempt_words(attempt: Attempt, shot: ExpectedShot | None = None) -> str:
    """Describe an attempt in Markdown."""
    outcome, used = attempt.outcome, attempt.used
    end = "no outcome recorded" if outcome is None else outcome.word
    if outcome is not None and not attempt.was_shot:
        end += ", given up without a shot"
    lines = [
        f"# {attempt.number}: {one_line(attempt.ball)}, attempt {attempt.of_ball}",
        f"**{end}**",
    ]
    if outcome is not None:
        facts: list[str] = []
        if outcome.shot_height_m is not None:
            facts.append(f"shot from {outcome.shot_height_m:.3f} m")
        if outcome.miss_m is not None:
            side = "short of" if outcome.miss_m < 0 else "beyond"
            facts.append(
                f"came down {1000 * abs(outcome.miss_m):.0f} mm from the centre, {side} it"
            )
        facts += [one_line(text) for text in (outcome.reason, outcome.note) if text]
        lines.append("; ".join(facts))
    if shot is not None:
        lines.append(_expected_words(shot))
    if attempt.value is not None:
        ends = attempt.interval95
        sure = f" (95 %: {ends[0]:.4f} to {ends[1]:.4f})" if ends is not None else ""
        lines.append(f"restitution **{attempt.value:.4f}**{sure}")
        for known in used.others if used is not None else ():  # tuned with the restitution
            assert isinstance(known.value, float)
            unit = "" if known.unit == "1" else f" {one_line(known.unit)}"
            words = f"{one_line(known.name).replace('_', ' ')} {known.value:.3f}{unit}"
            ends = known.interval95
            words += "" if ends is None else f" (95 %: {ends[0]:.3f} to {ends[1]:.3f})"
            lines.append(words)
    for drop in attempt.drops:
        reason = f": {one_line(drop.reason)}" if drop.reason else ""
        lines.append(f"- {drop.state} {one_line(drop.name)}{reason}")
    if used is not None and used.tuning is not None:
        review = used.tuning.with_suffix(".rrd")
        lines += [f"review of the drop: `rerun {one_line(review.name)}`"] if review.exists() else []
    return "\n\n".join(line for line in lines if line)


def _expected_words(shot: ExpectedShot) -> str:
    """Say where a shot was expected to come down, by its restitution's 95 %."""
    middle, *ends = (1000 * shot.offset_m).tolist()
    if isnan(middle):
        return "expected: it never comes down at the hoop's height"
    low, high = sorted(ends)
    sure = "" if isnan(low + high) else f" (95 % by the restitution: {low:+.0f} to {high:+.0f})"
    where = f"{abs(middle):.0f} mm {'short of' if middle < 0 else 'beyond'} the centre"
    return f"expected: {where}{sure}, {'through' if shot.is_through else 'not through'} the hoop"


# ---- Shot under the cursor, from the side: plane and hoop, its expected path, where it came down.

_BOARD: draw.Color = (150, 130, 105)
_RIM: draw.Color = (235, 90, 60)


def log_shots(
    stream: rr.RecordingStream, slots: Sequence[Slot], campaign: Campaign
) -> rrb.View | None:
    """Log each shot's expected path beside where it came down; None where no rig is known."""
    rig = campaign.rig
    if rig is None or not campaign.shots:
        return None
    sheet, ball_m = "sheets/shot", rig.ball.radius_m
    # The rig, from the side; Rerun's y points down.
    plane, hoop = rig.plane, rig.hoop
    ends = np.outer([-3 * ball_m, plane.downhill_m], plane.downhill)[:, [0, 2]]
    draw.log_strips(stream, f"{sheet}/plane", [_flipped(ends)], [_BOARD], 2.0, 5.0)
    rims = np.array([[hoop.forward_m + side * hoop.ring_radius_m, hoop.up_m] for side in (-1, 1)])
    draw.log_strips(stream, f"{sheet}/hoop", [_flipped(rims)], [draw.mixed(_RIM, 0.45)], 0.8, 6.0)
    draw.log_dots(stream, f"{sheet}/rim", _flipped(rims), [_RIM], 3.0, 7.0)
    shots = campaign.shots

    def paths(_: str, begun: list[Begun]) -> Any:
        """Draw the likeliest on top of both ends of its 95 %."""
        known = [shots.get(slot.attempt.number) for slot, _ in begun]
        strips = [
            [_flipped(_path(shot, which)) for which in (1, 2, 0)] if shot else [] for shot in known
        ]
        faint = draw.mixed(_TUNED, 0.4)
        columns = rr.LineStrips2D.columns(
            strips=[strip for some in strips for strip in some],
            colors=[color for some in strips if some for color in (faint, faint, _TUNED)],
        )
        return columns.partition([len(some) for some in strips])

    def happened(_: str, begun: list[Begun]) -> Any:
        seen = [_came_down(slot.attempt, hoop) for slot, _ in begun]
        told = [one for one in seen if one is not None]
        columns = rr.Points2D.columns(
            positions=[place for place, _, _ in told],
            labels=[words for _, words, _ in told],
            colors=[color for _, _, color in told],
        )
        return columns.partition([0 if one is None else 1 for one in seen])

    def words(_: str, begun: list[Begun]) -> Any:
        texts = [_shot_words(slot.attempt, shots.get(slot.attempt.number)) for slot, _ in begun]
        places = [_flipped(np.array([place]))[0] for place, _ in texts]
        columns = rr.Points2D.columns(positions=places, labels=[text for _, text in texts])
        return columns.partition([1] * len(texts))

    tops_m = [float(shot.paths_m[..., 2].max()) for shot in shots.values()]
    middle = np.array([hoop.forward_m / 2, max(tops_m) / 2])

    def _shot_words(attempt: Attempt, shot: ExpectedShot | None) -> tuple[Array, str]:
        if shot is not None and attempt.outcome is not None:
            above = shot.paths_m[0, 0, [0, 2]] + [0.0, 2.0 * ball_m]
            return above, f"let go {attempt.outcome.shot_height_m:.3f} m above"
        if not attempt.was_shot:
            return middle, "no shot"
        return middle, "its height or its ball is not known"

    style = rr.LineStrips2D.from_fields(radii=draw.screen_radius(1.2), draw_order=20.0)
    log_begun(stream, slots, f"{sheet}/expected", style, paths)
    style = rr.Points2D.from_fields(
        radii=draw.screen_radius(5.0), show_labels=True, draw_order=30.0
    )
    log_begun(stream, slots, f"{sheet}/happened", style, happened)
    style = rr.Points2D.from_fields(
        colors=[draw.MUTED], radii=draw.screen_radius(0.1), show_labels=True
    )
    log_begun(stream, slots, f"{sheet}/words", style, words)
    _log_flights(stream, slots, shots, ball_m)
    # All paths, and room for words above and below.
    every = np.concatenate([shot.paths_m[..., [0, 2]].reshape(-1, 2) for shot in shots.values()])
    every = np.concatenate([every, ends, rims])
    (left, low), (right, high) = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    room = 0.12 * max(right - left, high - low)
    return rrb.Spatial2DView(
        origin=f"/{sheet}",
        name="shot: expected line, real dot",
        background=draw.GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(float(left - room), float(right + room)),
            y_range=(float(-high - room), float(-low + room)),
        ),
    )


def _log_flights(
    stream: rr.RecordingStream, slots: Sequence[Slot], shots: Mapping[int, ExpectedShot], m: float
) -> None:
    """Log the ball of radius `m` as it flies along the expected path, on `FILM` alone."""
    entity = "sheets/shot/ball"
    style = rr.Points2D.from_fields(colors=[_TUNED], radii=[m], draw_order=25.0)
    log_gone(stream, slots, entity, style, (FILM,))
    for slot in slots:
        shot = shots.get(slot.attempt.number)
        if shot is None:
            continue
        path = _path(shot, 0)[::8]
        # Within the time that a shot takes up.
        film_s = slot.tuned_s + _STEP_S + np.linspace(0.0, _STEP_S, len(path))
        columns = rr.Points2D.columns(positions=_flipped(path))
        stream.send_columns(entity, [rr.TimeColumn(FILM, duration=film_s)], columns)


def _path(shot: ExpectedShot, which: int) -> Array:
    """Return forward and up of one path until its shot is over, shape (T, 2) [m]."""
    path = shot.paths_m[:, which][:, [0, 2]]
    moves = np.flatnonzero((path[1:] != path[:-1]).any(axis=1))
    return path[: moves[-1] + 2] if len(moves) else path


def _flipped(points: Array) -> Array:
    """Turn forward and up into a 2D view's right and down."""
    return points * [1.0, -1.0]


def _came_down(attempt: Attempt, hoop: Hoop) -> tuple[Array, str, draw.Color] | None:
    """Return where a shot came down, in words, and its colour; None where it was not measured."""
    outcome = attempt.outcome
    if outcome is None or outcome.miss_m is None or outcome.task != BOUNCE_SHOT:
        return None
    place = _flipped(np.array([[hoop.forward_m + outcome.miss_m, hoop.up_m]]))[0]
    color = draw.SUCCESS if outcome.success else draw.FAILURE
    return place, f"{outcome.word}: {1000 * outcome.miss_m:+.0f} mm", color


# ---- Charts of a whole campaign, a row per ball: success rates, and restitutions.


def log_rates(stream: rr.RecordingStream, every: Sequence[Rate]) -> rrb.View:
    """Log each success rate with its Wilson interval, and the paper's."""
    title = f"success rates{_cut(len(every))}, bars: 95 % (Wilson), violet: TuneNet's paper"
    every = every[: draw.MAX_ROWS]
    rows = draw.RowAxes(len(every), 0.0, 1.0)
    sheet = "sheets/rates"
    draw.log_frame(
        stream,
        sheet,
        rows,
        [(quarter / 4, f"{25 * quarter} %") for quarter in range(5)],
        [rate.name for rate in every],
        [_rate_words(rate) for rate in every],
    )
    counted = [(row, rate) for row, rate in enumerate(every) if rate.count]
    intervals = [
        (rows.y(row), rows.x(rate.interval95[0]), rows.x(rate.interval95[1]))
        for row, rate in counted
    ]
    color = draw.mixed(draw.SUCCESS, 0.45)
    draw.log_bars(stream, f"{sheet}/intervals", intervals, rows.pitch * 0.16, color)
    dots = [(rows.x(rate.fraction), rows.y(row)) for row, rate in counted]
    draw.log_dots(stream, f"{sheet}/shares", dots, [draw.SUCCESS], 4.0, 20.0)
    half = draw.HALF_ROW * rows.pitch
    strips = [
        [[rows.x(rate.published), rows.y(row) + end] for end in (-half, half)]
        for row, rate in enumerate(every)
        if rate.published is not None
    ]
    draw.log_strips(stream, f"{sheet}/published", strips, [(190, 150, 255)], 1.5, 18.0)
    return rows.view("rates", title)


def log_restitutions(stream: rr.RecordingStream, balls: Sequence[BallRestitutions]) -> rrb.View:
    """Log each attempt's restitution, and each ball's mean and standard deviation."""
    title = f"restitution by ball{_cut(len(balls))}: each attempt with its 95 %, band: mean ± sd"
    balls = balls[: draw.MAX_ROWS]
    ends = [value for ball in balls for value in ball.values]
    ends += [end for ball in balls for pair in ball.intervals95 if pair for end in pair]
    low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
    # With a span under .1 noise would look like a difference between balls.
    more = max(0.0, 0.1 - (high - low)) / 2 + 0.05 * (high - low)
    rows = draw.RowAxes(max(1, len(balls)), low - more, high + more)
    sheet = "sheets/spreads"
    marks = [(value, f"{value:.6g}") for value in draw.ticks(rows.low, rows.high, 5)]
    figures = [
        f"{ball.mean:.4f} (1)"
        if isnan(ball.sd)
        else f"{ball.mean:.4f} ± {ball.sd:.4f} ({len(ball.values)})"
        for ball in balls
    ]
    draw.log_frame(stream, sheet, rows, marks, [ball.name for ball in balls], figures)
    deviations = [
        (rows.y(row), rows.x(ball.mean - ball.sd), rows.x(ball.mean + ball.sd))
        for row, ball in enumerate(balls)
        if not isnan(ball.sd)
    ]
    thick = 2 * draw.HALF_ROW * rows.pitch
    draw.log_bars(stream, f"{sheet}/deviation", deviations, thick, draw.mixed(_TUNED, 0.2))
    dots: list[tuple[float, float]] = []
    bars: list[list[list[float]]] = []
    for row, ball in enumerate(balls):
        steps = max(1, len(ball.values) - 1)
        for index, (value, pair) in enumerate(zip(ball.values, ball.intervals95, strict=True)):
            y = rows.y(row) + (index / steps - 0.5) * 2 * 0.8 * draw.HALF_ROW * rows.pitch
            dots.append((rows.x(value), y))
            if pair is not None:
                bars.append([[rows.x(end), y] for end in pair])
    draw.log_strips(stream, f"{sheet}/intervals", bars, [_TUNED], 0.7, 15.0)
    draw.log_dots(stream, f"{sheet}/values", dots, [_TUNED], 2.2, 20.0)
    if not balls:
        draw.log_labels(stream, f"{sheet}/words", [[rows.width / 2, -0.5]], ["no drop was tuned"])
    return rows.view("spreads", title)


def _cut(count: int) -> str:
    """Say how many rows the chart has if not all."""
    return "" if count <= draw.MAX_ROWS else f" (the first {draw.MAX_ROWS} of {count})"


def _rate_words(rate: Rate) -> str:
    if not rate.count:
        return "none"
    low, high = rate.interval95
    return (
        f"{rate.successes}/{rate.count} = {100 * rate.fraction:.0f} % "
        f"({100 * low:.0f} to {100 * high:.0f})"
    )


# ---- Lanes: drop, tuning and outcome of each attempt as state timelines.

# In turn; muted, so that the lanes of states stand out.
_BALL_COLORS: tuple[draw.Color, ...] = (
    (90, 130, 190),
    (190, 120, 90),
    (100, 170, 120),
    (170, 110, 170),
    (180, 165, 90),
    (90, 170, 175),
)
_AMBER: draw.Color = (225, 165, 50)
_STATE_COLORS: dict[str, draw.Color] = {
    "drop": (66, 140, 220),
    "doubtful drop": _AMBER,
    "rejected drop": draw.FAILURE,
    "no drop": draw.MUTED,
    "tuned": (40, 165, 200),
    "not tuned": draw.MUTED,
    "shot": (160, 120, 220),
    "given up": _AMBER,
    "success": draw.SUCCESS,
    "failure": draw.FAILURE,
    "not told": draw.MUTED,
}
# Names that Rerun writes over the lanes, after a slash; it sorts them by the alphabet.
BALL, DROP, RESTITUTION, SHOT = LANES = ("ball", "drop", "restitution", "shot")


class _LaneChange(NamedTuple):
    """Change of a lane's state."""

    lane: str  # its name
    state: str  # in words, as drawn
    kind: str  # key of its colour
    attempt: int  # its number
    film_s: float  # where it begins on `FILM`
    wall_ns: int | None  # where it begins on `WALL`; None if unknown

    @property
    def value(self) -> str:
        """Label that is unique in each attempt: Rerun merges equal neighbours."""
        return f"attempt {self.attempt}: {self.state}"


def log_lanes(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    """Log drop, tuning and outcome of each attempt."""
    changes = [change for slot in slots for change in _changes(slot)]
    for lane in LANES:
        own = [change for change in changes if change.lane == lane]
        colors = _STATE_COLORS
        if lane == BALL:  # to each ball one that is unlike its neighbours'
            balls = dict.fromkeys(change.kind for change in own)
            colors = {
                ball: draw.mixed(_BALL_COLORS[index % len(_BALL_COLORS)], 0.75)
                for index, ball in enumerate(balls)
            }
        known = {change.value: change for change in own}
        # Every second attempt is a little darker, so that neighbours are told apart.
        style = rr.StateConfiguration(
            values=list(known),
            labels=[change.state for change in known.values()],
            colors=[
                draw.mixed(colors[change.kind], 1.0 if change.attempt % 2 else 0.78)
                for change in known.values()
            ],
        )
        stream.log(lane, style, static=True)
        # Of several changes in an attempt the last counts.
        last = {change.attempt: change.value for change in own}
        ends = {**last, slots[-1].attempt.number + 1: None}
        _send_states(stream, lane, rr.TimeColumn(ATTEMPT, sequence=list(ends)), list(ends.values()))
        played: dict[float, str | None] = {slot.start_s: None for slot in slots}  # not yet known
        played |= {change.film_s: change.value for change in own}
        played[slots[-1].end_s] = None
        _send_states(
            stream, lane, rr.TimeColumn(FILM, duration=list(played)), list(played.values())
        )
        clock: dict[int, str | None] = {
            slot.begin_ns: None for slot in slots if slot.begin_ns is not None
        }
        clock |= {change.wall_ns: change.value for change in own if change.wall_ns is not None}
        if clock:
            _send_states(stream, lane, wall_column(list(clock)), list(clock.values()))


def _changes(slot: Slot) -> Iterator[_LaneChange]:
    attempt, outcome = slot.attempt, slot.attempt.outcome
    number, begin_ns, end_ns = attempt.number, slot.begin_ns, slot.begin_ns
    if end_ns is not None and outcome is not None:
        end_ns = max(end_ns, outcome.stamp_ns)
    ball = one_line(attempt.ball)
    yield _LaneChange(BALL, f"{ball}, {attempt.of_ball}", ball, number, slot.start_s, begin_ns)
    for index, shown in enumerate(slot.drops):
        kind = shown.drop.state
        state = kind if kind == "drop" else kind.removesuffix(" drop")  # short ones are not cut
        state = f"{state} again" if index else state
        yield _LaneChange(DROP, state, kind, number, shown.start_s, slot.drop_ns(shown))
    if not slot.drops:
        yield _LaneChange(DROP, "no drop", "no drop", number, slot.start_s, begin_ns)
    kind = "tuned" if attempt.value is not None else "not tuned"
    value = kind if attempt.value is None else f"{attempt.value:.3f}"
    yield _LaneChange(RESTITUTION, value, kind, number, slot.tuned_s, slot.drop_ns(slot.used))
    if attempt.was_shot:
        yield _LaneChange(SHOT, "shot", "shot", number, slot.tuned_s + _STEP_S, None)
    word = "not told" if outcome is None else outcome.word if attempt.was_shot else "given up"
    yield _LaneChange(SHOT, word, word, number, slot.tuned_s + 2 * _STEP_S, end_ns)


def _send_states(
    stream: rr.RecordingStream, entity: str, index: rr.TimeColumn, states: Sequence[str | None]
) -> None:
    """Send the state from each time on; None for none."""
    known = [state for state in states if state is not None]
    columns = rr.StateChange.columns(state=known).partition([state is not None for state in states])
    stream.send_columns(entity, indexes=[index], columns=columns)


# ---- Summary in Markdown: rates beside the paper's, restitutions by ball.


def campaign_words(campaign: Campaign) -> str:
    """Format the campaign's tables as Markdown."""
    attempts = campaign.attempts
    drops = {id(drop): drop for attempt in attempts for drop in attempt.drops}
    rejected = sum(drop.verdict == "rejected" for drop in drops.values())
    ended = sum(attempt.outcome is not None for attempt in attempts)
    rates: list[tuple[str, ...]] = []
    for rate in (*overall_rates(attempts), *ball_rates(attempts)):
        low, high = rate.interval95
        fraction = f"{100 * rate.fraction:.0f} %" if rate.count else "-"
        ends = f"{100 * low:.0f} to {100 * high:.0f} %" if rate.count else "-"
        paper = "" if rate.published is None else f"{100 * rate.published:.0f} %"
        rates.append((one_line(rate.name), f"{rate.successes}/{rate.count}", fraction, ends, paper))
    rows: list[tuple[str, ...]] = []
    for ball in restitutions_by_ball(attempts):
        halves = [(high - low) / 2 for pair in ball.intervals95 if pair for low, high in [pair]]
        interval = f"± {median(halves):.4f}" if halves else "-"
        sd = "-" if isnan(ball.sd) else f"{ball.sd:.4f}"
        ends = f"{min(ball.values):.4f} to {max(ball.values):.4f}"
        figures = str(len(ball.values)), f"{ball.mean:.4f}", sd, ends, interval
        rows.append((one_line(ball.name), *figures))
    outcomes = [attempt.outcome for attempt in attempts if attempt.outcome is not None]
    misses = sorted(abs(one.miss_m) for one in outcomes if one.miss_m is not None)
    measured = "none was measured"
    if misses:
        measured = f"{len(misses)} measured: median {1000 * median(misses):.0f} mm, "
        measured += f"largest {1000 * misses[-1]:.0f} mm"
    head = ("ball", "drops", "mean", "sd", "least to most", "usual 95 %")
    lines = [
        f"# {one_line(campaign.name)}",
        f"{len(attempts)} attempts, {len(drops)} drops ({rejected} rejected), {ended} outcomes",
        "## Success",
        markdown_table(("of", "successes", "rate", "95 % (Wilson)", "paper"), rates),
        "## Restitution",
        markdown_table(head, rows) if rows else "none was tuned",
        "## Misses",
        measured,
    ]
    return "\n\n".join(lines)


# ---- Recording: all parts, and the blueprint that lays them out.


def write_campaign(campaign: Campaign, path: Path) -> None:
    """Write the review of a campaign to `path` (.rrd)."""
    words = campaign_words(campaign)
    identity = subject_of(campaign.places) + hashlib.sha256(words.encode()).hexdigest()[:16]
    with draw.written(path, "campaign", identity, campaign.name) as stream:
        slots = slots_of(campaign.attempts)
        log_lanes(stream, slots)
        rates = (*overall_rates(campaign.attempts), *ball_rates(campaign.attempts))
        restitutions = restitutions_by_ball(campaign.attempts)
        charts = [log_rates(stream, rates), log_restitutions(stream, restitutions)]
        rows = log_attempts(stream, slots, campaign)
        name = short_name(campaign.name, 40)  # in the titles of views
        # All lanes, over the whole active timeline, above the charts and the attempt at the cursor.
        shares = [0.36, 1 - 0.36]  # all lanes are in view on a small screen too
        lanes = [
            rrb.StateTimelineView(
                contents=[f"+ /{lane}" for lane in LANES],
                name=f"{name}: the attempts (a click goes to one{more})",
            )
            for more in ("; the next tab shows it", "")
        ]
        overview = rrb.Vertical(
            lanes[0], rrb.Horizontal(*charts), row_shares=shares, name="overview"
        )
        attempt = rrb.Vertical(lanes[1], rows, row_shares=shares, name="attempt")
        summary = rrb.TextDocumentView(origin="/summary", name=f"{name}: all figures")
        tabs = rrb.Tabs(overview, attempt, rrb.Horizontal(summary, name="tables"), active_tab=0)
        time = rrb.TimePanel(state="collapsed", timeline=ATTEMPT, play_state="paused")
        stream.send_blueprint(draw.blueprint(tabs, time))
        draw.log_words(stream, "summary", words)
