"""From a flight on to both ends of the recording, by how the ball looks and moves."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.arcs import Arc
from analysis.tracking.blobs import BallColor
from analysis.tracking.candidates import Candidates
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

LEAST_SEEN = 8

_LOST_S = 0.4
_LOST_FRAMES = 12
_RECENT = 4
_MISFIT = 0.35
_ALIKE_PLACES = 2
_MOST_SHOWN = 24


def same_arc(table: Candidates, arc: Arc, places: Array) -> Arc:
    """The flight among new candidates."""
    apart = np.linalg.norm(table.places_px[arc.frames] - places[arc.frames][:, None], axis=2)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    if not apart.size:
        raise NotFoundError("the ball looks like what is behind it (mark it with --hsv)")
    nearest = apart.argmin(axis=1)
    area = float(np.nanmedian(table.areas_px[arc.frames, nearest]))
    near = apart[np.arange(len(nearest)), nearest] < 2 + np.sqrt(area / np.pi)
    if near.sum() < 3:
        raise NotFoundError("the ball looks like what is behind it (mark it with --hsv)")
    return Arc(arc.frames[near], nearest[near], arc.gravity_px)


def look_of(table: Candidates, arc: Arc) -> BallColor:
    """Colour and size of what flies."""
    colours = table.colours[arc.frames, arc.chosen]
    areas = table.areas_px[arc.frames, arc.chosen]
    return BallColor(np.median(colours, axis=0), float(np.median(areas)))


def follow(table: Candidates, arc: Arc, look: BallColor) -> tuple[NDArray[np.intp], Array]:
    """From the middle of the flight on, to both ends of the recording.

    Returns:
        The candidate of each picture (-1 for none) and what speaks against it, shapes (T,).
    """
    chosen = np.full(len(table.seconds), -1)
    cost = np.full(len(table.seconds), np.inf)
    margin = max((len(arc.frames) - LEAST_SEEN) // 2, 0)  # an arc may miss some near its ends
    middle = slice(margin, len(arc.frames) - margin)
    core, core_picks = arc.frames[middle], arc.chosen[middle]
    chosen[core] = core_picks
    cost[core] = _unlike(table, core, core_picks, look)
    for step in (1, -1):
        frames, picks = core[::step], core_picks[::step]
        _follow_on(table, frames, picks, arc.gravity_px, look, step, chosen, cost)
    return chosen, cost


def flying(
    arc: Arc, chosen: NDArray[np.intp], places_px: Array, look: BallColor
) -> tuple[NDArray[np.intp], int]:
    """Pictures that show the moving ball well apart, at most a few; and the first without it."""
    found = chosen >= 0
    first, last = int(arc.frames[0]), int(arc.frames[-1])
    gaps = np.flatnonzero(~found[last:])
    end = last + (int(gaps[0]) if len(gaps) else len(chosen) - last)  # followed without a break
    shown: list[int] = []
    for at in range(first, end):
        crowd = np.linalg.norm(places_px[shown] - places_px[at], axis=1) if shown else np.empty(0)
        if found[at] and (crowd < look.radius_px / 2).sum() < _ALIKE_PLACES:
            shown.append(at)
    some = np.linspace(0, len(shown) - 1, min(_MOST_SHOWN, len(shown))).astype(int)
    return np.array(shown, np.intp)[some], end


def still_places(seconds: Array, arc: Arc, places_px: Array, end: int) -> Array:
    """Where the ball was before its flight was seen, and may lie after it, shape (T, 2).

    Backwards along the flight's parabola to where it is at rest, and there; later, the lowest place
    up to `end`, until when it was followed without a break. NaN in flight.
    """
    begin = int(arc.frames[0])
    clock = seconds[arc.frames] - seconds[begin]
    curve = np.polyfit(clock, places_px[arc.frames], 2)
    down = arc.gravity_px / np.linalg.norm(arc.gravity_px)
    times = seconds - seconds[begin]
    released = -float(curve[1] @ down) / max(2 * float(curve[0] @ down), 1e-9)
    times = np.maximum(times, released)[:, None]
    still = curve[0] * times**2 + curve[1] * times + curve[2]
    still[begin : arc.frames[-1] + 1] = np.nan
    followed = places_px[begin:end]
    still[arc.frames[-1] + 1 :] = followed[int(np.argmax(followed @ down))]
    return still


def hiding_places(
    frame: int, arc: Arc, places_px: Array, still_px: Array, look: BallColor
) -> Array:
    """Where the ball may be in a picture, so that it is not taken for the background, shape (K, 2).

    A ball that has come to rest lies in most pictures, so that it does not stand out of their
    median, and was lost before it got there: a little above.
    """
    if frame <= arc.frames[-1] or not np.isfinite(still_px[frame, 0]):
        return places_px[frame][None]
    down = arc.gravity_px / np.linalg.norm(arc.gravity_px)
    below = [still_px[frame] + steps * look.radius_px * down for steps in (0.0, 2.0, 4.0)]
    return np.stack([places_px[frame], *below])


def _follow_on(
    table: Candidates,
    frames: NDArray[np.intp],
    picks: NDArray[np.intp],
    gravity: Array,
    look: BallColor,
    step: int,
    chosen: NDArray[np.intp],
    cost: Array,
) -> None:
    radius = look.radius_px
    last, before = int(frames[-1]), int(frames[-2])
    place = table.places_px[last, picks[-1]]
    seconds = table.seconds
    span = seconds[last] - seconds[before]
    velocity = (place - table.places_px[before, picks[-2]]) / span + gravity * span / 2
    speeds = deque([float(np.linalg.norm(velocity))], maxlen=_RECENT)
    patience = max(_LOST_S, _LOST_FRAMES * float(np.median(np.diff(seconds))))
    frame = last + step
    while 0 <= frame < len(seconds) and abs(seconds[frame] - seconds[last]) < patience:
        dt = seconds[frame] - seconds[last]
        expected = place + velocity * dt + gravity * dt**2 / 2
        # A bounce between two pictures makes the way between them short, and the next one long.
        speed = max(speeds) + float(np.linalg.norm(gravity)) * abs(dt)
        off = np.linalg.norm(table.places_px[frame] - expected, axis=1)
        moved = np.linalg.norm(table.places_px[frame] - place, axis=1)
        reach = 1.3 * speed * abs(dt) + radius + 2
        near = np.minimum((off / (radius + 1)) ** 2, 4.0)  # a bounce is not what was expected
        against = near + _unlike(table, np.full(len(off), frame), np.arange(len(off)), look)
        against = np.where(moved < reach, against, np.inf)
        against = np.where(np.isfinite(against), against, np.inf)
        best = int(against.argmin()) if len(against) else -1
        if best >= 0 and against[best] < 12:
            new = table.places_px[frame, best]
            velocity = (new - place) / dt + gravity * dt / 2
            speeds.append(float(np.linalg.norm(velocity)))
            place, last = new, frame
            chosen[frame], cost[frame] = best, against[best]
        frame += step


def _unlike(
    table: Candidates, frames: NDArray[np.intp], picks: NDArray[np.intp], look: BallColor
) -> Array:
    colour = np.linalg.norm(table.colours[frames, picks] - look.colour, axis=1) / 45
    size = np.log(table.areas_px[frames, picks] / look.area_px) / 0.6
    return colour**2 + size**2 + (table.misfits[frames, picks] / _MISFIT) ** 2
