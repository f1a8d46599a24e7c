"""Where the tuned ball goes through the picture, and where it hits."""

from __future__ import annotations

import numpy as np
import rerun as rr

from analysis.drop.film import FilmedDrop
from analysis.drop.review.story import Curve, ReviewData
from analysis.review.sending import at_seconds, screen_radius
from tunenet_logs.arrays import Array

_IMPACT = (255, 90, 90)
_FEWEST = 4
"""Samples of a flight whose own way sideways can be told."""

_FINE = 4
"""Points of the path for each picture."""


def log_model_path(stream: rr.RecordingStream, film: FilmedDrop, story: ReviewData) -> None:
    """Send the path of the result through the picture, its impacts, and the latest one's name."""
    curve = story.simulated[-1]
    line = rr.LineStrips2D(
        [model_path(film, story)],
        colors=[(*curve.color, 170)],
        radii=screen_radius(0.7),
        draw_order=6.0,
    )
    stream.log("film/path", line, static=True)
    impacts = story.impacts_s
    places = film_places(film, impacts, np.zeros(len(impacts)), impacts) + 0.5
    marks = rr.Points2D(places, colors=[_IMPACT], radii=screen_radius(2.5), draw_order=7.0)
    stream.log("film/impacts", marks, static=True)
    shown = rr.Points2D.from_fields(
        colors=[_IMPACT], radii=screen_radius(4.0), show_labels=True, draw_order=14.0
    )
    stream.log("film/impact", shown, static=True)
    names = [_name(story, index) for index in range(len(impacts))]
    columns = rr.Points2D.columns(positions=places, labels=names)
    nothing_yet = [0] + [1] * len(impacts)
    index = at_seconds(np.concatenate([film.drop.seconds[:1], impacts]))
    stream.send_columns("film/impact", indexes=[index], columns=columns.partition(nothing_yet))


def model_path(film: FilmedDrop, story: ReviewData) -> Array:
    """Where the camera would see the result's ball go [px]: with all its impacts, shape (N, 2)."""
    curve, impacts = story.simulated[-1], story.impacts_s
    count = _FINE * (len(curve.seconds) - 1) + 1
    fine = np.interp(np.arange(count) / _FINE, np.arange(len(curve.seconds)), curve.seconds)
    seconds = np.unique(np.concatenate([fine, impacts]))
    known = np.concatenate([curve.seconds, impacts])
    order = np.argsort(known, kind="stable")
    levels = np.concatenate([curve.heights_m, np.zeros(len(impacts))])
    heights = np.interp(seconds, known[order], levels[order]) / story.drop_height_m
    return film_places(film, seconds, heights, impacts) + 0.5


def projected_places(
    film: FilmedDrop, curve: Curve, drop_height_m: float, impacts_s: Array | None = None
) -> Array:
    """Where the camera would see a simulated ball at the times of the observed one [px].

    Args:
        film: the drop as it was filmed.
        curve: heights above contact over the log's time.
        drop_height_m: of the drop.
        impacts_s: see `film_places`.

    Returns:
        Shape (T, 2).
    """
    heights = np.interp(film.drop.seconds, curve.seconds, curve.heights_m) / drop_height_m
    return film_places(film, film.drop.seconds, heights, impacts_s)


def film_places(
    film: FilmedDrop, seconds: Array, heights: Array, impacts_s: Array | None = None
) -> Array:
    """Where the camera sees heights [drop heights] at these times [px], shape (T, 2).

    The projection knows the image's vertical alone; sideways the ball goes as the observed one, at
    one speed, or at one for each flight between `impacts_s`.
    """
    sideways = np.array([film.down_px[1], -film.down_px[0]])
    observed = film.track.places_px[film.used] @ sideways
    knots = _knots(film.drop.seconds, np.array([]) if impacts_s is None else impacts_s)
    hats = np.eye(len(knots))
    design = np.column_stack([np.interp(film.drop.seconds, knots, hat) for hat in hats])
    ways, *_ = np.linalg.lstsq(design, observed, rcond=None)
    across = np.interp(seconds, knots, ways)
    along = film.projection.places_px(heights)
    return np.outer(-along, film.down_px) + np.outer(across, sideways)


def _knots(seconds: Array, impacts_s: Array) -> Array:
    """The impacts between flights of some samples, and both ends."""
    knots = [float(seconds[0])]
    for at in impacts_s:
        before = np.count_nonzero((seconds > knots[-1]) & (seconds <= at))
        if before >= _FEWEST and np.count_nonzero(seconds > at) >= _FEWEST:
            knots.append(float(at))
    return np.array([*knots, float(seconds[-1])])


def _name(story: ReviewData, index: int) -> str:
    """What is written at an impact, until the next."""
    if index < len(story.bounces):
        return f"bounce {index + 1}: {story.bounces[index].restitution:.3f}"
    return f"bounce {index + 1}"
