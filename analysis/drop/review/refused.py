"""Review of a tracked film that makes no drop: the track over the pictures, and its height.

What looks like an impact is marked, so that it can be seen where the ball does what no drop does.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.drop.detection import FilmDetection
from analysis.drop.film_search import film_impacts
from analysis.drop.review.film import log_balls, log_pictures
from analysis.drop.review.sound import log_beside, sound_of
from analysis.record import Tuning
from analysis.review.drawing import IMPACT, OBSERVED, Color, screen_radius, send_scalars
from analysis.statistics import noise_of
from tunenet_logs.arrays import Array

_TRACK: Color = (120, 170, 255)

_MIN_COUNT = 12  # places in which impacts are looked for
_MIN_NOISE_PX = 0.1


def log_refused(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send pictures, track and height in the picture; None where the ball is nowhere."""
    found: FilmDetection | None = tuning.refused
    if found is None:
        return None
    track = found.track
    known = np.isfinite(track.places_px).all(axis=1)
    if not known.any():
        return None
    seconds = (track.stamps_ns[known] - found.start_ns).astype(np.float64) * 1e-9
    places_px = track.places_px[known]
    first_ns, last_ns = track.stamps_ns[[0, -1]].tolist()
    log_pictures(stream, tuning, found, (first_ns, last_ns))
    stamps, first = np.unique(track.stamps_ns, return_index=True)
    all_s = (stamps - found.start_ns).astype(np.float64) * 1e-9
    places, radii = track.places_px[first], track.radius_px[first]
    log_balls(stream, "film/observed", all_s, places, radii, OBSERVED, 1.6)
    whole = rr.LineStrips2D(
        _without_gaps(track.places_px),
        colors=[(*_TRACK, 170)],
        radii=screen_radius(0.7),
        draw_order=6.0,
    )
    stream.log("film/track", whole, static=True)
    high_px = _heights_px(track.gravity_px, places_px)
    impacts = _impacts(seconds, high_px)
    marks = rr.Points2D(
        places_px[impacts] + 0.5, colors=[IMPACT], radii=screen_radius(3.5), draw_order=7.0
    )
    stream.log("film/impacts", marks, static=True)
    size = 0.5 * max(track.size_px)
    low, high = places_px.min(axis=0) - 0.1 * size, places_px.max(axis=0) + 0.1 * size
    video = rrb.Spatial2DView(
        origin="/film",
        name=f"video: the tracked ball (white), found in {np.mean(known):.0%} of the pictures",
        visual_bounds=rrb.VisualBounds2D(
            x_range=(float(low[0]), float(high[0])), y_range=(float(low[1]), float(high[1]))
        ),
    )
    heights = _log_heights(stream, seconds, high_px, impacts)
    sound = sound_of(tuning.episode)
    ends_s = float(all_s[0]), float(all_s[-1])
    heard = None if sound is None else log_beside(stream, sound, found.start_ns, ends_s, ends_s[1])
    if heard is None:
        return rrb.Vertical(video, heights, row_shares=[3, 2])
    return rrb.Vertical(video, heights, heard, row_shares=[4, 2, 2])


def _without_gaps(places_px: Array) -> list[Array]:
    """Split the track into runs of pictures with the ball, shape (n, 2) each, as Rerun counts."""
    known = np.isfinite(places_px).all(axis=1)
    edges = np.flatnonzero(np.diff(known)) + 1
    runs = np.split(places_px + 0.5, edges)
    return [run for run in runs if len(run) > 1 and np.isfinite(run).all()]


def _heights_px(gravity_px: Array, places_px: Array) -> Array:
    """Return heights along the image's vertical, above the lowest place, shape (T,) [px]."""
    norm = float(np.linalg.norm(gravity_px))
    down = gravity_px / norm if norm > 0 else np.array([0.0, 1.0])
    along = -(places_px @ down)
    return along - along.min()


def _impacts(seconds: Array, high_px: Array) -> list[int]:
    """Return the indices at which the ball looks as if it hit something."""
    if len(seconds) < _MIN_COUNT or np.any(np.diff(seconds) <= 0):
        return []
    return list(film_impacts(seconds, high_px, max(noise_of(high_px), _MIN_NOISE_PX)))


def _log_heights(
    stream: rr.RecordingStream, seconds: Array, high_px: Array, impacts: list[int]
) -> rrb.View:
    """Send the height in the picture over the log's time, and what looks like impacts."""
    points = rr.SeriesPoints(colors=[OBSERVED], names=["tracked"], marker_sizes=[2.0])
    stream.log("height/observed", points, static=True)
    send_scalars(stream, "height/observed", seconds, high_px)
    if impacts:
        mark = rr.SeriesPoints(
            colors=[IMPACT], names=["impact?"], markers=["diamond"], marker_sizes=[6.0]
        )
        stream.log("height/impact", mark, static=True)
        send_scalars(stream, "height/impact", seconds[impacts], high_px[impacts])
    return rrb.TimeSeriesView(
        origin="/height",
        name="height in the picture [px], red: what looks like an impact",
        plot_legend=rrb.PlotLegend(visible=False),
    )
