"""The attempt under the cursor: its drop's curves, its pictures, and what is known of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.campaign.attempts import Attempt
from analysis.campaign.tuned_drop import TunedDrop
from analysis.review.campaign.times import ATTEMPT, FILM, WALL, Shown, Slot, at_attempts
from analysis.review.drawing import (
    FAILURE,
    OBSERVED,
    Color,
    chart_view,
    log_grid,
    screen_radius,
    ticks,
)
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import one_line

_WIDTH = 1.9
"""Of the chart of curves, in its heights: about the shape of its view."""

_SIMULATED: Color = (255, 165, 40)

_EVERY = 3
"""The moving dot is at every third sample: it still goes smoothly, and the file stays small."""


def log_attempts(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    """Send the entities of `overlay_view`, `film_view` and `attempt_view`."""
    _log_overlays(stream, slots)
    _log_films(stream, slots)
    style = rr.TextDocument.from_fields(media_type="text/markdown")
    stream.log("attempt", style, static=True)
    words = rr.TextDocument.columns(text=[attempt_words(slot.attempt) for slot in slots])
    stream.send_columns("attempt", indexes=at_attempts(slots), columns=words)


def overlay_view() -> rrb.View:
    """Observed and simulated height of the drop of the attempt."""
    title = "its drop: height above the table, observed (dots), tuned (line)"
    return chart_view("overlay", title, _WIDTH)


def film_view() -> rrb.View:
    """The pictures of the drop."""
    return rrb.Spatial2DView(origin="/film", name="its video (timeline film_s plays it)")


def attempt_view() -> rrb.View:
    """What is known of the attempt, in words."""
    return rrb.TextDocumentView(origin="/attempt", name="the attempt")


class _Axes(NamedTuple):
    """What the chart of curves spans: seconds from a drop's beginning, and height [m]."""

    span_s: float
    top_m: float

    def points(self, drop: TunedDrop, heights_m: Array) -> Array:
        """Points of a curve in the chart, shape (T, 2), from heights of shape (T,)."""
        assert drop.overlay is not None
        seconds = drop.overlay.seconds - drop.overlay.seconds[0]
        return np.column_stack([seconds / self.span_s * _WIDTH, -heights_m / self.top_m])


def _axes(slots: Sequence[Slot]) -> _Axes:
    overlays = [
        shown.drop.overlay
        for slot in slots
        for shown in slot.drops
        if shown.drop.overlay is not None
    ]
    if not overlays:
        return _Axes(1.0, 1.0)
    span_s = max(float(overlay.seconds[-1] - overlay.seconds[0]) for overlay in overlays)
    top_m = max(float(overlay.observed_m.max()) for overlay in overlays)
    return _Axes(span_s, max(1.02 * top_m, 1e-3))


def _log_overlays(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    axes = _axes(slots)
    rows = [(-height / axes.top_m, f"{height:g} m") for height in ticks(0.0, axes.top_m)]
    marks = [(second / axes.span_s * _WIDTH, f"{second:g} s") for second in ticks(0.0, axes.span_s)]
    log_grid(stream, "sheets/overlay", _WIDTH, rows, marks)
    dots = rr.Points2D.from_fields(radii=screen_radius(1.6))
    stream.log("sheets/overlay/observed", dots, static=True)
    line = rr.LineStrips2D.from_fields(
        colors=[_SIMULATED], radii=screen_radius(0.8), draw_order=25.0
    )
    stream.log("sheets/overlay/simulated", line, static=True)
    by_attempt = [(slot, slot.drops[-1] if slot.drops else None) for slot in slots]
    _send_overlays(
        stream,
        rr.TimeColumn(ATTEMPT, sequence=[slot.attempt.number for slot, _ in by_attempt]),
        [shown.drop if shown else None for _, shown in by_attempt],
        axes,
    )
    every = [shown for slot in slots for shown in slot.drops]
    starts = rr.TimeColumn(FILM, duration=[shown.start_s for shown in every])
    _send_overlays(stream, starts, [shown.drop for shown in every], axes)
    _log_now(stream, every, axes)


def _send_overlays(
    stream: rr.RecordingStream,
    index: rr.TimeColumn,
    drops: Sequence[TunedDrop | None],
    axes: _Axes,
) -> None:
    """One row a drop; an empty one where there is no curve, so that no other's stays."""
    observed = [_observed(drop, axes) for drop in drops]
    colors = [
        FAILURE if drop is not None and drop.verdict == "rejected" else OBSERVED
        for drop, points in zip(drops, observed, strict=True)
        for _ in points
    ]
    lengths = [len(points) for points in observed]
    if not lengths:
        return
    stream.send_columns(
        "sheets/overlay/observed",
        indexes=[index],
        columns=rr.Points2D.columns(
            positions=np.concatenate(observed).reshape(-1, 2), colors=colors
        ).partition(lengths),
    )
    lines = [list(_simulated(drop, axes)) for drop in drops]
    stream.send_columns(
        "sheets/overlay/simulated",
        indexes=[index],
        columns=rr.LineStrips2D.columns(
            strips=[strip for strips in lines for strip in strips]
        ).partition([len(strips) for strips in lines]),
    )


def _observed(drop: TunedDrop | None, axes: _Axes) -> Array:
    if drop is None or drop.overlay is None:
        return np.zeros((0, 2))
    return axes.points(drop, drop.overlay.observed_m)


def _simulated(drop: TunedDrop | None, axes: _Axes) -> Iterator[Array]:
    if drop is not None and drop.overlay is not None:
        yield axes.points(drop, drop.overlay.simulated_m)


def _log_now(stream: rr.RecordingStream, every: Sequence[Shown], axes: _Axes) -> None:
    """A dot that goes along the curves while the film plays."""
    style = rr.Points2D.from_fields(colors=[OBSERVED], radii=screen_radius(5.0), draw_order=30.0)
    stream.log("sheets/overlay/now", style, static=True)
    for shown in every:
        overlay = shown.drop.overlay
        if overlay is None:
            continue
        seconds = [shown.film_s(float(second)) for second in overlay.seconds[::_EVERY]]
        points = axes.points(shown.drop, overlay.observed_m)[::_EVERY]
        stream.send_columns(
            "sheets/overlay/now",
            indexes=[rr.TimeColumn(FILM, duration=seconds)],
            columns=rr.Points2D.columns(positions=points),
        )


def _log_films(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    for slot in slots:
        for shown in slot.drops:
            _log_film(stream, shown)
        used = slot.attempt.used
        stream.reset_time()
        stream.set_time(ATTEMPT, sequence=slot.attempt.number)
        if used is not None and used.film is not None:
            still = rr.EncodedImage(contents=used.film.strobe, media_type="image/jpeg")
            stream.log("film/picture", still)
        else:
            stream.log("film/picture", rr.Clear(recursive=False))
        stream.reset_time()


def _log_film(stream: rr.RecordingStream, shown: Shown) -> None:
    """The pictures of one drop, each where it belongs in the film."""
    film = shown.drop.film
    if film is None:
        stream.reset_time()
        stream.set_time(FILM, duration=shown.start_s)
        stream.log("film/picture", rr.Clear(recursive=False))
        stream.reset_time()
        return
    indexes = [rr.TimeColumn(FILM, duration=[shown.film_s(second) for second in film.seconds])]
    if shown.drop.wall_ns is not None:
        start = np.datetime64(film.start_ns, "ns")
        offsets = (np.array(film.seconds) * 1e9).astype(np.int64).astype("timedelta64[ns]")
        indexes.append(rr.TimeColumn(WALL, timestamp=start + offsets))
    columns = rr.EncodedImage.columns(
        blob=list(film.pictures), media_type=["image/jpeg"] * len(film.pictures)
    )
    stream.send_columns("film/picture", indexes=indexes, columns=columns)


def attempt_words(attempt: Attempt) -> str:
    """What is known of an attempt, as Markdown."""
    outcome, used = attempt.outcome, attempt.used
    end = "no outcome recorded" if outcome is None else outcome.word
    if outcome is not None and not attempt.was_shot:
        end += ", given up without a shot"
    lines = [
        f"# {attempt.number}: {one_line(attempt.ball)}, attempt {attempt.of_ball}",
        f"**{end}**",
    ]
    if outcome is not None:
        lines.append(_shot_words(attempt))
    if attempt.value is not None:
        ends = attempt.interval95
        sure = f" (95 %: {ends[0]:.4f} to {ends[1]:.4f})" if ends is not None else ""
        lines.append(f"restitution **{attempt.value:.4f}**{sure}")
    lines += [_drop_words(drop) for drop in attempt.drops]
    if used is not None and used.tuning is not None:
        review = used.tuning.with_suffix(".rrd")
        lines += [f"review of the drop: `rerun {one_line(review.name)}`"] if review.exists() else []
    return "\n\n".join(line for line in lines if line)


def _shot_words(attempt: Attempt) -> str:
    outcome = attempt.outcome
    assert outcome is not None
    facts: list[str] = []
    if outcome.shot_height_m is not None:
        facts.append(f"shot from {outcome.shot_height_m:.3f} m")
    if outcome.miss_m is not None:
        side = "short of" if outcome.miss_m < 0 else "beyond"
        facts.append(f"came down {1000 * abs(outcome.miss_m):.0f} mm from the centre, {side} it")
    facts += [one_line(text) for text in (outcome.reason, outcome.note) if text]
    return "; ".join(facts)


def _drop_words(drop: TunedDrop) -> str:
    reason = f": {one_line(drop.reason)}" if drop.reason else ""
    return f"- {drop.state} {one_line(drop.name)}{reason}"
