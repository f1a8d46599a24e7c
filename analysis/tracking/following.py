"""Tracking of the ball through the candidates, from its flight to both ends of the recording."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.arcs import SLACK_PX, Arc
from analysis.tracking.candidates import Candidates, ColorAndSize
from tunenet_logs.arrays import Array

MIN_SEEN = 8  # pictures with the ball: fewer are no drop and no bounce
# Without the ball, in seconds or in pictures, whichever is longer: the way is lost. It covers what
# passes before the ball, and slow films.
_LOST_S, _LOST_FRAMES = 0.4, 12

# Speeds, of which the largest bounds the next: a bounce between two pictures makes the way between
# them short, and the next one long.
_RECENT = 4

_REACH = 1.3  # of the way at that speed: noise in it, and in the positions
# Squared distance from where it is expected, in ball radii, that counts at most: a bounce is not
# what was expected.
_MAX_OFF = 4.0

_MAX_AGAINST = 12.0  # sum of squares, each of about 1 for the ball, above which a candidate is none
# Differences that count 1: in RGB (0 to 255), in the logarithm of the area, and of a `Placing`.
COLOUR_OFF, _LOG_AREA, _MISFIT = 45.0, 0.6, 0.35

# Pictures with the ball within half a radius of one place that are enough: more of the same
# background teach nothing of the ball.
_ALIKE_POSITIONS = 2

# Pictures that the ball's appearance is learnt from: all of them are in memory at once.
_MAX_SHOWN = 24


def color_and_size(
    table: Candidates, frames: NDArray[np.intp], chosen: NDArray[np.intp]
) -> ColorAndSize:
    """Return the medians of some candidates, one in each of these pictures."""
    colours = table.colours[frames, chosen]
    areas = table.areas_px[frames, chosen]
    return ColorAndSize(np.median(colours, axis=0), float(np.median(areas)))


def follow(table: Candidates, arc: Arc, ball: ColorAndSize) -> tuple[NDArray[np.intp], Array]:
    """Follow the ball from the middle of its flight to both ends of the recording.

    In each picture the candidate is taken that is most like the ball and nearest to where constant
    acceleration from the last one would have brought it.

    Returns:
        The candidate of each picture (-1 for none) and what speaks against it, shapes (T,).
    """
    chosen = np.full(len(table.seconds), -1)
    cost = np.full(len(table.seconds), np.inf)
    margin = max((len(arc.frames) - MIN_SEEN) // 2, 0)  # an arc may miss some near its ends
    middle = slice(margin, len(arc.frames) - margin)
    core, core_picks = arc.frames[middle], arc.chosen[middle]
    chosen[core] = core_picks
    cost[core] = _unlike(table, core, core_picks, ball)
    seconds, gravity, radius = table.seconds, arc.gravity_px, ball.radius_px
    patience = max(_LOST_S, _LOST_FRAMES * float(np.median(np.diff(seconds))))
    for step in (1, -1):
        frames, picks = core[::step], core_picks[::step]
        last, before = int(frames[-1]), int(frames[-2])
        position = table.places_px[last, picks[-1]]
        span = seconds[last] - seconds[before]
        velocity = (position - table.places_px[before, picks[-2]]) / span + gravity * span / 2
        speeds = deque([float(np.linalg.norm(velocity))], maxlen=_RECENT)
        frame = last + step
        while 0 <= frame < len(seconds) and abs(seconds[frame] - seconds[last]) < patience:
            dt = seconds[frame] - seconds[last]
            expected = position + velocity * dt + gravity * dt**2 / 2
            speed = max(speeds) + float(np.linalg.norm(gravity)) * abs(dt)
            off = np.linalg.norm(table.places_px[frame] - expected, axis=1)
            moved = np.linalg.norm(table.places_px[frame] - position, axis=1)
            reach = _REACH * speed * abs(dt) + radius + SLACK_PX
            near = np.minimum((off / (radius + 1)) ** 2, _MAX_OFF)
            against = near + _unlike(table, np.full(len(off), frame), np.arange(len(off)), ball)
            against = np.where(moved < reach, against, np.inf)
            against = np.where(np.isfinite(against), against, np.inf)
            best = int(against.argmin()) if len(against) else -1
            if best >= 0 and against[best] < _MAX_AGAINST:
                new = table.places_px[frame, best]
                velocity = (new - position) / dt + gravity * dt / 2
                speeds.append(float(np.linalg.norm(velocity)))
                position, last = new, frame
                chosen[frame], cost[frame] = best, against[best]
            frame += step
    return chosen, cost


def flight_and_rest(
    seconds: Array, arc: Arc, chosen: NDArray[np.intp], positions_px: Array, radius_px: float
) -> tuple[NDArray[np.intp], Array]:
    """Select pictures that show the moving ball, and where it may lie in the others.

    Before the flight it is where the flight's parabola, followed backwards, comes to rest, and on
    the way from there; after it, at the lowest position before the first picture without it.

    Args:
        seconds: of the pictures, shape (T,).
        arc: its flight.
        chosen: its candidate in each picture, -1 for none, shape (T,).
        positions_px: where it was seen, shape (T, 2).
        radius_px: of the ball.

    Returns:
        Numbers of at most 24 pictures, increasing, shape (N,); and positions [px], shape (T, 2),
        NaN in flight.
    """
    found = chosen >= 0
    first, last = int(arc.frames[0]), int(arc.frames[-1])
    gaps = np.flatnonzero(~found[last:])
    end = last + (int(gaps[0]) if len(gaps) else len(chosen) - last)  # followed without a break
    shown: list[int] = []
    for at in range(first, end):
        apart = positions_px[shown] - positions_px[at] if shown else np.empty((0, 2))
        crowd = np.linalg.norm(apart, axis=1)
        if found[at] and (crowd < radius_px / 2).sum() < _ALIKE_POSITIONS:
            shown.append(at)
    some = np.linspace(0, len(shown) - 1, min(_MAX_SHOWN, len(shown))).astype(int)
    clock = seconds[arc.frames] - seconds[first]
    curve = np.polyfit(clock, positions_px[arc.frames], 2)
    down = arc.gravity_px / np.linalg.norm(arc.gravity_px)
    times = seconds - seconds[first]
    released = -float(curve[1] @ down) / max(2 * float(curve[0] @ down), 1e-9)
    times = np.maximum(times, released)[:, None]
    still = curve[0] * times**2 + curve[1] * times + curve[2]
    still[first : last + 1] = np.nan
    followed = positions_px[first:end]
    still[last + 1 :] = followed[int(np.argmax(followed @ down))]
    return np.array(shown, np.intp)[some], still


def _unlike(
    table: Candidates, frames: NDArray[np.intp], picks: NDArray[np.intp], ball: ColorAndSize
) -> Array:
    """Return the squared differences from the ball in colour, size and misfit, shape (N,)."""
    colour = np.linalg.norm(table.colours[frames, picks] - ball.colour, axis=1) / COLOUR_OFF
    size = np.log(table.areas_px[frames, picks] / ball.area_px) / _LOG_AREA
    return colour**2 + size**2 + (table.misfits[frames, picks] / _MISFIT) ** 2
