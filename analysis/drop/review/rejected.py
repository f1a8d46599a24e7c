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
    log_balls,
    log_beside,
    log_pictures,
    log_sound,
    sound_of,
)
from tunenet_logs.analysis.drop.times.detection import TimesDetection
from tunenet_logs.analysis.drop.track import recorded_heights
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.onsets import onsets
from tunenet_logs.analysis.review import drawing as draw
from tunenet_logs.analysis.statistics import noise_of
from tunenet_logs.episode import UNSTATED, Array, Sound
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.terminal import short_name

# ---- Film: the track over the pictures, and its height


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
    log_balls(stream, "film/observed", all_s, places, radii, draw.OBSERVED, 1.6)
    # The track in runs of pictures with the ball, shape (n, 2) each, as Rerun counts.
    runs = np.split(track.places_px + 0.5, np.flatnonzero(np.diff(known)) + 1)
    runs = [run for run in runs if len(run) > 1 and np.isfinite(run).all()]
    draw.log_strips(stream, "film/track", runs, [(120, 170, 255, 170)], 0.7, 6.0)
    # Heights along the image's vertical, above the lowest place, shape (T,) [px].
    norm = float(np.linalg.norm(track.gravity_px))
    down = track.gravity_px / norm if norm > 0 else np.array([0.0, 1.0])
    along = -(places_px @ down)
    high_px = along - along.min()
    impacts: list[int] = []  # where it looks as if it hit something
    if len(seconds) >= 12 and np.all(np.diff(seconds) > 0):
        impacts = film_impacts(seconds, high_px, max(noise_of(high_px), 0.1))
    draw.log_dots(stream, "film/impacts", places_px[impacts] + 0.5, [draw.IMPACT], 3.5, 7.0)
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
    draw.log_marks(stream, "height/observed", "tracked", draw.OBSERVED, 2.0, seconds, high_px)
    marks = seconds[impacts], high_px[impacts]
    draw.log_marks(stream, "height/impact", "impact?", draw.IMPACT, 6.0, *marks, "diamond")
    heights = draw.plot_view("height", "height in the picture [px], red: what looks like an impact")
    sound = sound_of(tuning.episode)
    ends_s = float(all_s[0]), float(all_s[-1])
    heard = None if sound is None else log_beside(stream, sound, found.start_ns, ends_s, ends_s[1])
    if heard is None:
        return rrb.Vertical(video, heights, row_shares=[3, 2])
    return rrb.Vertical(video, heights, heard, row_shares=[4, 2, 2])


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


def _log_knocks(
    stream: rr.RecordingStream,
    sound: Sound,
    begin_s: float,
    span_s: tuple[float, float],
    knocks_s: Array,
) -> rrb.View | None:
    marks = (Marks("knock", "knock", draw.IMPACT, knocks_s),)
    said = f"red: what knocks ({len(knocks_s)})" if len(knocks_s) else "nothing knocks"
    return log_sound(stream, sound, begin_s, span_s, marks, said)


# ---- A good drop, to compare with


def log_good_drop(stream: rr.RecordingStream) -> rrb.View:
    """Send the heights of a good drop by time, with what each part of it is."""
    seconds = np.linspace(-1.6, 5.0, 900)  # since the first impact, in the time of the fall
    heights = Bounce(restitution=0.72).heights(seconds)
    across = (seconds - seconds[0]) / np.ptp(seconds) * draw.WIDTH
    draw.log_grid(stream, "sheets/good", draw.WIDTH, [(0.0, "table")], [])
    draw.log_strips(
        stream, "sheets/good/height", [np.column_stack([across, -heights])], [draw.SUCCESS], 1.2
    )
    said = {  # times and heights of words
        -1.2: (1.1, "still in the hand"),
        0.2: (0.75, "falls in view"),
        3.2: (0.45, "bounces in view until it lies still"),
    }
    places = [
        [(at - seconds[0]) / np.ptp(seconds) * draw.WIDTH, -height - 0.1]
        for at, (height, _) in said.items()
    ]
    draw.log_labels(stream, "sheets/good/words", places, [words for _, words in said.values()])
    return draw.chart_view("good", "how the height of a good drop looks")


# ---- Positions in which no drop was found: the heights searched, and likely impacts

_MAX = 3  # signals with a view of their own: those in which a drop is sought first
_MAX_LETTERS = 40  # of a signal's name in a title


def log_refused_heights(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send the likeliest signals' heights, and the sound beside; None without positions."""
    found = recorded_heights(tuning.episode, _MAX) if tuning.episode else []
    # What --start and --end left to be searched.
    named = tuning.provenance.options if tuning.provenance else {}
    begin_s, end_s = float(named.get("start_s", -np.inf)), float(named.get("end_s", np.inf))
    views: list[rrb.View] = []
    for number, one in enumerate(found):
        entity = f"sought/{number}"
        size = 1.0 if len(one.seconds) > 200 else 2.0  # larger dots would hide each other
        style = "height", draw.OBSERVED, size
        draw.log_marks(stream, f"{entity}/height", *style, one.seconds, one.heights)
        at = np.array(one.impacts, np.intp)
        at = at[(one.seconds[at] >= begin_s) & (one.seconds[at] <= end_s)]
        style, marks = ("impact?", draw.IMPACT, 6.0), (one.seconds[at], one.heights[at])
        draw.log_marks(stream, f"{entity}/impact", *style, *marks, "diamond")
        unit = "" if one.signal.unit == UNSTATED else f" [{one.signal.unit}]"
        name = short_name(one.signal.name, _MAX_LETTERS)
        said = f"red: {len(at)} that may be impacts" if len(at) else "nothing looks like an impact"
        said += "" if one.is_free else ", no free fall"
        ends_s = max(begin_s, float(one.seconds[0])), min(end_s, float(one.seconds[-1]))
        views.append(draw.plot_view(entity, f"height of {name}{unit}: {said}", shown_s=ends_s))
    if not views:
        return None
    sound = sound_of(tuning.episode)
    if sound is not None:
        span_s = max(begin_s, float(found[0].seconds[0])), min(end_s, float(found[0].seconds[-1]))
        begin_s = (sound.start_ns - int(found[0].signal.stamps_ns[0])) * 1e-9
        knocks_s = onsets(sound).times_s + begin_s
        knocks_s = knocks_s[(knocks_s >= span_s[0]) & (knocks_s <= span_s[1])]
        heard = _log_knocks(stream, sound, begin_s, span_s, knocks_s)
        views += [] if heard is None else [heard]
    return rrb.Vertical(*views)


# ---- Impact times that are no bouncing ball's: how long each is after the one before


def log_refused_times(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
    """Send the gaps between the times of each signal; None where none has two."""
    signals = tuning.episode.signals.values() if tuning.episode else ()
    views: list[rrb.View] = []
    for signal in [one for one in signals if len(one.stamps_ns) > 1][:_MAX]:
        seconds = np.sort(signal.seconds)
        gaps_ms = 1000.0 * np.diff(seconds)
        entity, style = f"gaps/{len(views)}", ("since the one before", draw.OBSERVED, 5.0)
        draw.log_marks(stream, entity, *style, seconds[1:], gaps_ms)
        name = short_name(signal.name, _MAX_LETTERS)
        title = f"{name}: time since the one before [ms]; a ball's shrinks by a ratio"
        longest = draw.ticked(0.0, 1.1 * max(float(gaps_ms.max()), 1.0))
        views.append(draw.plot_view(entity, title, longest))
    return rrb.Vertical(*views) if views else None
