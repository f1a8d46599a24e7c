"""The video, with the tracked ball, its trail, and the simulated balls over it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.film import FilmedDrop
from analysis.drop.review.model_path import log_model_path, projected_places
from analysis.drop.review.story import ReviewData
from analysis.review.colors import OBSERVED
from analysis.review.pictures import reduced, send_pictures
from analysis.review.sending import at_seconds, screen_radius
from analysis.tracking.pictures import readable_frames
from analysis.tuning import Tuning
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError

_TRAIL_S = 0.35
_CORNERS = 24
_MOST_BYTES = 48 * 1024 * 1024
_NARROW = 0.6
"""Width over height of a view that has no room for a longer name."""


def log_film(stream: rr.RecordingStream, tuning: Tuning, story: ReviewData) -> None:
    """Send the entities of `film_view`: pictures, track and simulated balls, on the log's time."""
    film: FilmedDrop = tuning.found.film
    _log_pictures(stream, tuning, film)
    seconds = film.drop.seconds
    places = film.track.places_px[film.used]
    radii = film.track.radius_px[film.used]
    _log_balls(stream, "film/observed", seconds, places, radii, OBSERVED, 1.6)
    begin = np.searchsorted(seconds, seconds - _TRAIL_S)
    trails = [places[first : index + 1] for index, first in enumerate(begin)]
    style = rr.LineStrips2D.from_fields(
        colors=[(*OBSERVED, 150)], radii=screen_radius(0.8), draw_order=8.0
    )
    stream.log("film/trail", style, static=True)
    columns = rr.LineStrips2D.columns(strips=[[trail] for trail in trails])
    stream.send_columns("film/trail", indexes=[at_seconds(seconds)], columns=columns)
    log_model_path(stream, film, story)
    usual = np.full(len(seconds), float(np.nanmedian(radii)))
    for k, curve in enumerate(story.simulated):
        width = 1.8 if k == len(story.simulated) - 1 else 1.0
        where = projected_places(film, curve, story.drop_height_m, story.impacts_s)
        _log_balls(stream, f"film/k{k}", seconds, where, usual, curve.color, width)


def film_view(film: FilmedDrop, story: ReviewData) -> rrb.View:
    """The video under the circles of observed and simulated balls, opened at the ball's way."""
    (left, right), (top, bottom) = _opened_at(film)
    name = f"video: observed white, k=0 to {len(story.simulated) - 1} cold to warm"
    if film_aspect(film) < _NARROW:
        name = "video"
    return rrb.Spatial2DView(
        origin="/film",
        name=name,
        visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(top, bottom)),
    )


def film_aspect(film: FilmedDrop) -> float:
    """Width over height of what the view opens at."""
    (left, right), (top, bottom) = _opened_at(film)
    return (right - left) / (bottom - top)


def _opened_at(film: FilmedDrop) -> tuple[tuple[float, float], tuple[float, float]]:
    """The ball's way with room around it, as wide as it is high where the picture is."""
    size = np.array(film.track.size_px, np.float64)
    places = film.track.places_px[film.used]
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    half = np.minimum(0.7 * (high - low).max() + 10, size / 2)
    middle = np.clip((low + high) / 2, half, size - half)
    (left, top), (right, bottom) = middle - half, middle + half
    return (float(left), float(right)), (float(top), float(bottom))


def _log_balls(
    stream: rr.RecordingStream,
    entity: str,
    seconds: Array,
    places: Array,
    radii: Array,
    colour: tuple[int, int, int],
    width: float,
) -> None:
    """A circle around the ball at each time: a disc would hide it."""
    style = rr.LineStrips2D.from_fields(
        colors=[colour], radii=screen_radius(width / 2), draw_order=10.0 + width
    )
    stream.log(entity, style, static=True)
    turns = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    strips = places[:, None] + np.maximum(radii, 3.0)[:, None, None] * circle + 0.5
    columns = rr.LineStrips2D.columns(strips=[[strip] for strip in strips])
    stream.send_columns(entity, indexes=[at_seconds(seconds)], columns=columns)


def _log_pictures(stream: rr.RecordingStream, tuning: Tuning, film: FilmedDrop) -> None:
    """The pictures of the drop as they were recorded; bare pixels, or far too many, reduced."""
    frames = list(_frames_of(tuning, film))
    if not frames:
        return
    send_pictures(stream, frames, tuning.found.start_ns)
    scale = film.track.size_px[0] / frames[0].size_px()[0]
    stream.log("film/picture", rr.Transform3D(scale=scale), static=True)


def _frames_of(tuning: Tuning, film: FilmedDrop) -> Iterator[Frame]:
    assert tuning.episode is not None
    stamps = film.track.stamps_ns[film.used]
    taken_ns = tuning.found.taken_ns
    shown: list[Frame] = []
    for recorded in readable_frames(tuning.episode, tuning.found.topic):
        frame = replace(recorded, stamp_ns=taken_ns.get(recorded.stamp_ns, recorded.stamp_ns))
        if not stamps[0] <= frame.stamp_ns <= stamps[-1]:
            continue
        try:
            picture = frame if frame.encoding == "jpeg" else reduced(frame)
            picture.size_px()
        except LogError:
            continue
        shown.append(picture)
    if sum(len(frame.data) for frame in shown) > _MOST_BYTES:
        shown = [reduced(frame) for frame in shown]
    return iter(shown)
