"""Video of the tracked ball and its trail, and over them the simulated balls and their path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.detection import FilmDetection
from analysis.drop.film import FilmedDrop
from analysis.drop.review.review_data import ReviewData, begin_s
from analysis.record import Tuning
from analysis.review.drawing import IMPACT, OBSERVED, Color, at_seconds, screen_radius
from analysis.review.pictures import frames_to_show, reduced, send_pictures
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError

# Of the track behind the ball: a bounce's shape can be seen, older bounces are out of the way.
_TRAIL_S = 0.35

_CORNERS = 24  # of the polygon that is drawn as a circle
_MIN_RADIUS_PX = 3.0  # of a circle: a smaller one would hide the ball
# Of recorded pictures; more are made smaller, so that the review can be loaded soon.
_MAX_BYTES = 48 * 1024 * 1024

_NARROW = 0.6  # width over height of a view that has no room for a longer name
_MIN_COUNT = 4  # samples of a flight, at least, from which its own speed sideways is fitted
# Points of the path for each picture: it is drawn as a curve where pictures are far apart.
_FINE = 4


def log_film(
    stream: rr.RecordingStream, tuning: Tuning, data: ReviewData
) -> tuple[rrb.View, float]:
    """Send the video with circles around observed and simulated balls, on the log's time.

    Returns:
        Its view, opened at the ball's way, and that view's width over its height.
    """
    film: FilmedDrop = tuning.detection.film
    shown = film.drop.seconds >= begin_s(tuning.detection)
    first_ns, last_ns = film.track.stamps_ns[film.used][shown][[0, -1]].tolist()
    log_pictures(stream, tuning, tuning.detection, (first_ns, last_ns))
    seconds = film.drop.seconds[shown]
    observed = film.track.places_px[film.used][shown]
    radii = film.track.radius_px[film.used][shown]
    log_balls(stream, "film/observed", seconds, observed, radii, OBSERVED, 1.6)
    log_trail(stream, seconds, observed)
    _log_path(stream, film, data)
    usual = np.full(len(seconds), float(np.nanmedian(radii)))
    for k, curve in enumerate(data.simulated):
        width = 1.8 if k == len(data.simulated) - 1 else 1.0
        heights = np.interp(seconds, curve.seconds, curve.heights_m) / data.drop_height_m
        positions = film_positions(film, seconds, heights, data.impacts_s)
        log_balls(stream, f"film/k{k}", seconds, positions, usual, curve.color, width)
    return _view(film, observed, len(data.simulated))


def _view(film: FilmedDrop, observed_px: Array, count: int) -> tuple[rrb.View, float]:
    """Build a view of the ball's way with room around it, as wide as it is high."""
    size = np.array(film.track.size_px, np.float64)
    low, high = np.nanmin(observed_px, axis=0), np.nanmax(observed_px, axis=0)
    half = np.minimum(0.7 * (high - low).max() + 10, size / 2)
    middle = np.clip((low + high) / 2, half, size - half)
    (left, top), (right, bottom) = (middle - half).tolist(), (middle + half).tolist()
    aspect = (right - left) / (bottom - top)
    name = f"video: observed white, k=0 to {count - 1} cold to warm"
    view = rrb.Spatial2DView(
        origin="/film",
        name="video" if aspect < _NARROW else name,
        visual_bounds=rrb.VisualBounds2D(x_range=(left, right), y_range=(top, bottom)),
    )
    return view, aspect


def log_trail(stream: rr.RecordingStream, seconds: Array, places_px: Array) -> None:
    """Send the trail of the ball's last positions."""
    begin = np.searchsorted(seconds, seconds - _TRAIL_S)
    trails = [places_px[first : index + 1] + 0.5 for index, first in enumerate(begin)]
    style = rr.LineStrips2D.from_fields(
        colors=[(*OBSERVED, 150)], radii=screen_radius(0.8), draw_order=8.0
    )
    stream.log("film/trail", style, static=True)
    columns = rr.LineStrips2D.columns(strips=[[trail] for trail in trails])
    stream.send_columns("film/trail", indexes=[at_seconds(seconds)], columns=columns)


def log_balls(
    stream: rr.RecordingStream,
    entity: str,
    seconds: Array,
    positions_px: Array,
    radii_px: Array,
    color: Color,
    width: float,
) -> None:
    """Send a circle around the ball at each time, none at NaN: a disc would hide the ball."""
    style = rr.LineStrips2D.from_fields(
        colors=[color], radii=screen_radius(width / 2), draw_order=10.0 + width
    )
    stream.log(entity, style, static=True)
    turns = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    drawn_px = np.maximum(radii_px, _MIN_RADIUS_PX)
    # Rerun's (0, 0) is a corner of the first pixel, ours its middle.
    strips = positions_px[:, None] + drawn_px[:, None, None] * circle + 0.5
    columns = rr.LineStrips2D.columns(
        strips=[[strip] if np.isfinite(strip).all() else [] for strip in strips]
    )
    stream.send_columns(entity, indexes=[at_seconds(seconds)], columns=columns)


def log_pictures(
    stream: rr.RecordingStream, tuning: Tuning, found: FilmDetection, span_ns: tuple[int, int]
) -> None:
    """Send the pictures of this time as recorded; bare pixels, or far too many, reduced."""
    assert tuning.episode is not None
    shown: list[Frame] = []
    for recorded in frames_to_show(tuning.episode, found.topic):
        stamp_ns = found.taken_ns.get(recorded.stamp_ns, recorded.stamp_ns)
        frame = replace(recorded, stamp_ns=stamp_ns)
        if not span_ns[0] <= frame.stamp_ns <= span_ns[1]:
            continue
        try:
            picture = frame if frame.encoding == "jpeg" else reduced(frame)
            picture.size_px()
        except LogError:
            continue
        shown.append(picture)
    if sum(len(frame.data) for frame in shown) > _MAX_BYTES:
        shown = [reduced(frame) for frame in shown]
    if shown:
        send_pictures(stream, shown, found.start_ns)
        scale = found.track.size_px[0] / shown[0].size_px()[0]
        stream.log("film/picture", rr.Transform3D(scale=scale), static=True)


def _log_path(stream: rr.RecordingStream, film: FilmedDrop, data: ReviewData) -> None:
    """Send the path of the result through the picture, its impacts, and the latest one's name."""
    line = rr.LineStrips2D(
        [model_path(film, data)],
        colors=[(*data.simulated[-1].color, 170)],
        radii=screen_radius(0.7),
        draw_order=6.0,
    )
    stream.log("film/path", line, static=True)
    impacts = data.impacts_s
    positions = film_positions(film, impacts, np.zeros(len(impacts)), impacts) + 0.5
    marks = rr.Points2D(positions, colors=[IMPACT], radii=screen_radius(2.5), draw_order=7.0)
    stream.log("film/impacts", marks, static=True)
    latest = rr.Points2D.from_fields(
        colors=[IMPACT], radii=screen_radius(4.0), show_labels=True, draw_order=14.0
    )
    stream.log("film/impact", latest, static=True)
    names = [f"bounce {k + 1}" for k in range(len(impacts))]
    for k, bounce in enumerate(data.bounces[: len(names)]):
        names[k] += f": {bounce.restitution:.3f}"
    columns = rr.Points2D.columns(positions=positions, labels=names)
    nothing_yet = [0] + [1] * len(impacts)
    index = at_seconds(np.concatenate([data.observed.seconds[:1], impacts]))
    stream.send_columns("film/impact", indexes=[index], columns=columns.partition(nothing_yet))


def model_path(film: FilmedDrop, data: ReviewData) -> Array:
    """Project the way of the result's ball, with all its impacts, shape (N, 2) [px].

    From the corner of the first pixel, as Rerun counts.
    """
    curve, impacts = data.simulated[-1], data.impacts_s
    count = _FINE * (len(curve.seconds) - 1) + 1
    fine = np.interp(np.arange(count) / _FINE, np.arange(len(curve.seconds)), curve.seconds)
    seconds = np.unique(np.concatenate([fine, impacts]))
    if data.ball is None:
        heights = np.interp(seconds, curve.seconds, curve.heights_m) / data.drop_height_m
    else:
        heights = data.ball.heights(seconds)
    return film_positions(film, seconds, heights, impacts) + 0.5


def film_positions(
    film: FilmedDrop, seconds: Array, heights: Array, impacts_s: Array | None = None
) -> Array:
    """Project a ball at these heights into the picture.

    The projection knows the image's vertical alone; sideways the ball goes as the observed one: a
    piecewise linear least-squares fit with one speed, or one for each flight between `impacts_s`.

    Args:
        film: the drop as it was filmed.
        seconds: on the log's time, shape (T,) [s].
        heights: above contact, shape (T,) [drop heights].
        impacts_s: on the log's time, shape (I,) [s].

    Returns:
        Positions from the middle of the first pixel, shape (T, 2) [px].
    """
    sideways = np.array([film.down_px[1], -film.down_px[0]])
    observed = film.track.places_px[film.used] @ sideways
    knots = _knots(film.drop.seconds, np.array([]) if impacts_s is None else impacts_s)
    hats = np.eye(len(knots))
    design = np.column_stack([np.interp(film.drop.seconds, knots, hat) for hat in hats])
    ways, *_ = np.linalg.lstsq(design, observed, rcond=None)
    across = np.interp(seconds, knots, ways)
    along = film.projection.positions(heights, seconds)
    return np.outer(-along, film.down_px) + np.outer(across, sideways)


def _knots(seconds: Array, impacts_s: Array) -> Array:
    """Return the impacts between flights of enough samples, and both ends, shape (K,) [s]."""
    knots = [float(seconds[0])]
    for at in impacts_s:
        before = np.count_nonzero((seconds > knots[-1]) & (seconds <= at))
        if before >= _MIN_COUNT and np.count_nonzero(seconds > at) >= _MIN_COUNT:
            knots.append(float(at))
    return np.array([*knots, float(seconds[-1])])
