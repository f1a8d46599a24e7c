"""Reviews of what makes no drop: a tracked film, a sound, positions, impact times.

What looks like an impact is marked, so that it can be seen where the ball does what no drop does.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tunenet_logs.analysis.drop.detection import FilmDetection
from tunenet_logs.analysis.drop.film import film_impacts
from tunenet_logs.analysis.drop.review.views import (
    Marks,
    diamonds,
    dots,
    log_balls,
    log_beside,
    log_pictures,
    log_series,
    log_sound,
    plot,
    sound_of,
)
from tunenet_logs.analysis.drop.times.detection import TimesDetection
from tunenet_logs.analysis.drop.track import RecordedHeight, recorded_heights
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.onsets import onsets
from tunenet_logs.analysis.review.drawing import (
    IMPACT,
    OBSERVED,
    Color,
    entity_of,
    screen_radius,
    ticked,
)
from tunenet_logs.analysis.statistics import noise_of
from tunenet_logs.episode import UNSTATED, Array, Sound
from tunenet_logs.terminal import short_name

# ---- Film: the track over the pictures, and its height

_TRACK: Color = (120, 170, 255)


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
    # Heights along the image's vertical, above the lowest place, shape (T,) [px].
    norm = float(np.linalg.norm(track.gravity_px))
    down = track.gravity_px / norm if norm > 0 else np.array([0.0, 1.0])
    along = -(places_px @ down)
    high_px = along - along.min()
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
    # Its height in the picture over the log's time, and what looks like impacts.
    log_series(stream, "height/observed", dots(OBSERVED, "tracked", 2.0), seconds, high_px)
    if impacts:
        style = diamonds(IMPACT, "impact?")
        log_series(stream, "height/impact", style, seconds[impacts], high_px[impacts])
    heights = plot("/height", "height in the picture [px], red: what looks like an impact")
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


def _impacts(seconds: Array, high_px: Array) -> list[int]:
    """Return the indices at which the ball looks as if it hit something."""
    if len(seconds) < 12 or np.any(np.diff(seconds) <= 0):
        return []
    return list(film_impacts(seconds, high_px, max(noise_of(high_px), 0.1)))


# ---- Sound in which no ball is heard, or beside no drop: its envelope and onsets


def log_refused_sound(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send envelope and onsets; None where there is no sound, or it is silent."""
    found: TimesDetection | None = tuning.refused
    if found is not None and found.listened is not None:
        sound, span_s = found.listened.sound, found.listened.part_s
        knocks_s = found.listened.knocks.times_s
    else:
        sound = sound_of(tuning.episode)
        if sound is None:
            return None
        span_s, knocks_s = (0.0, sound.lasts_s), onsets(sound).times_s
    view = _log_knocks(stream, sound, 0.0, span_s, knocks_s)
    return None if view is None else rrb.Vertical(view)


def log_sound_of_heights(
    stream: rr.RecordingStream, tuning: Tuning, start_ns: int, span_s: tuple[float, float]
) -> rrb.View | None:
    """Send the sound beside positions without a drop; None where there is none, or it is silent."""
    sound = sound_of(tuning.episode)
    if sound is None:
        return None
    begin_s = (sound.start_ns - start_ns) * 1e-9
    knocks_s = onsets(sound).times_s + begin_s
    inside = (knocks_s >= span_s[0]) & (knocks_s <= span_s[1])
    return _log_knocks(stream, sound, begin_s, span_s, knocks_s[inside])


def _log_knocks(
    stream: rr.RecordingStream,
    sound: Sound,
    begin_s: float,
    span_s: tuple[float, float],
    knocks_s: Array,
) -> rrb.View | None:
    marks = (Marks("knock", "knock", IMPACT, knocks_s),)
    said = f"red: what knocks ({len(knocks_s)})" if len(knocks_s) else "nothing knocks"
    return log_sound(stream, sound, begin_s, span_s, marks, said)


# ---- Positions in which no drop was found: the heights searched, and likely impacts

_MAX = 3  # signals with a view of their own: those in which a drop is sought first
_MAX_LETTERS = 40  # of a signal's name in a title


def log_refused_heights(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send the likeliest signals' heights, and the sound beside; None without positions."""
    found = recorded_heights(tuning.episode, _MAX) if tuning.episode else []
    views = [_log_height(stream, number, one) for number, one in enumerate(found)]
    if not views:
        return None
    likeliest = found[0]
    start_ns = int(likeliest.signal.stamps_ns[0])
    span_s = float(likeliest.seconds[0]), float(likeliest.seconds[-1])
    heard = log_sound_of_heights(stream, tuning, start_ns, span_s)
    return rrb.Vertical(*views) if heard is None else rrb.Vertical(*views, heard)


def _log_height(stream: rr.RecordingStream, number: int, height: RecordedHeight) -> rrb.View:
    origin = entity_of("sought", str(number))
    size = 1.0 if len(height.seconds) > 200 else 2.0  # larger dots would hide each other
    style = dots(OBSERVED, "height", size)
    log_series(stream, f"{origin}/height", style, height.seconds, height.heights)
    at = np.array(height.impacts, np.intp)
    if len(at):
        style = diamonds(IMPACT, "impact?")
        log_series(stream, f"{origin}/impact", style, height.seconds[at], height.heights[at])
    unit = "" if height.signal.unit == UNSTATED else f" [{height.signal.unit}]"
    name = short_name(height.signal.name, _MAX_LETTERS)
    marked = f"red: {len(at)} that may be impacts" if len(at) else "nothing looks like an impact"
    free = "" if height.is_free else ", no free fall"
    return plot(f"/{origin}", f"height of {name}{unit}: {marked}{free}")


# ---- Impact times that are no bouncing ball's: how long each is after the one before


def log_refused_times(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send the gaps between the times of each signal; None where none has two."""
    signals = tuning.episode.signals.values() if tuning.episode else ()
    views: list[rrb.View] = []
    for signal in [one for one in signals if len(one.stamps_ns) > 1][:_MAX]:
        seconds = np.sort(signal.seconds)
        gaps_ms = 1000.0 * np.diff(seconds)
        entity = entity_of("gaps", str(len(views)))
        style = dots(OBSERVED, "since the one before", 5.0)
        log_series(stream, entity, style, seconds[1:], gaps_ms)
        name = short_name(signal.name, _MAX_LETTERS)
        title = f"{name}: time since the one before [ms]; a ball's shrinks by a ratio"
        longest = ticked(0.0, 1.1 * max(float(gaps_ms.max()), 1.0))
        views.append(plot(f"/{entity}", title, values=longest))
    return rrb.Vertical(*views) if views else None
