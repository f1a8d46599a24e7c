"""The ball in each picture, once a flight shows how it looks: detected, and followed.

`BallDetector` finds candidates by the ball's appearance about where it is expected; `follow` picks
one of each picture, from the flight on to both ends of the recording.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.appearance import Appearance, Placing
from analysis.tracking.arcs import SLACK_PX, Arc
from analysis.tracking.background import Background
from analysis.tracking.candidates import Blobs, Candidates, ColorAndSize, coloured_blobs
from tunenet_logs.arrays import Array, Picture

LEAST_SEEN = 8
"""Pictures with the ball: fewer are no drop and no bounce."""

_LOST_S, _LOST_FRAMES = 0.4, 12
"""Without the ball, in seconds or in pictures, whichever is longer: the way is lost. It covers what
passes before the ball, and slow films."""

_RECENT = 4
"""Speeds, of which the largest bounds the next: a bounce between two pictures makes the way
between them short, and the next one long."""

_REACH = 1.3
"""Of the way at that speed: noise in it, and in the positions."""

_MOST_OFF = 4.0
"""Squared distance from where it is expected, in ball radii, that counts at most: a bounce is not
what was expected."""

_MOST_AGAINST = 12.0
"""Sum of squares, each of about 1 for the ball, above which a candidate is none."""

_COLOUR, _LOG_AREA, _MISFIT = 45.0, 0.6, 0.35
"""Differences that count 1: in RGB (0 to 255), in the logarithm of the area, and of a `Placing`."""

_ALIKE_POSITIONS = 2
"""Pictures with the ball within half a radius of one place that are enough: more of the same
background teach nothing of the ball."""

_MOST_SHOWN = 24
"""Pictures that the ball's appearance is learnt from: all of them are in memory at once."""

_SURE = 0.3
"""Misfit of a `Placing` below which nothing better is looked for."""

_MOST_STARTS = 3
"""Blobs of the ball's colour that a fit starts from: each costs a fit."""

_GROWN = (0.65, 1.5)
"""Least and most of such a start's radius over the ball's: a blob may be cut, or have grown
together with something else."""

_MIDDLE = 0.6
"""Of the radius: half the side of a square that lies within the ball."""

_SURROUNDINGS = 5.0
"""Ball radii around a position in which to look for what is like the ball."""

_COARSE_PX = 4.0
"""Radius to which a larger ball is reduced to look there; also, in reduced pixels, how far
apart the places are that are found."""

_LIKELIEST = 2
"""Places there: a shadow or a reflection may be more like the ball than the ball."""


def color_and_size(
    table: Candidates, frames: NDArray[np.intp], chosen: NDArray[np.intp]
) -> ColorAndSize:
    """The medians of some candidates, one in each of these pictures."""
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
    margin = max((len(arc.frames) - LEAST_SEEN) // 2, 0)  # an arc may miss some near its ends
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
            near = np.minimum((off / (radius + 1)) ** 2, _MOST_OFF)
            against = near + _unlike(table, np.full(len(off), frame), np.arange(len(off)), ball)
            against = np.where(moved < reach, against, np.inf)
            against = np.where(np.isfinite(against), against, np.inf)
            best = int(against.argmin()) if len(against) else -1
            if best >= 0 and against[best] < _MOST_AGAINST:
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
    """Pictures that show the moving ball in different places, and where it may lie in the others.

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
    some = np.linspace(0, len(shown) - 1, min(_MOST_SHOWN, len(shown))).astype(int)
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
    """Squared differences of candidates from the ball in colour, size and misfit, shape (N,)."""
    colour = np.linalg.norm(table.colours[frames, picks] - ball.colour, axis=1) / _COLOUR
    size = np.log(table.areas_px[frames, picks] / ball.area_px) / _LOG_AREA
    return colour**2 + size**2 + (table.misfits[frames, picks] / _MISFIT) ** 2


@dataclass(frozen=True, eq=False)
class BallDetector:
    """Finds the ball in one picture, once it is known how it looks and about where it is.

    Attributes:
        background: without it.
        ball: its colour and size.
        appearance: None where that could not be learnt.
        allowed: see `Pictures.allowed`.
    """

    background: Background
    ball: ColorAndSize
    appearance: Appearance | None
    allowed: Picture | None

    def find(self, picture: Picture, expected_px: Array, still_px: Array) -> Blobs:
        """Candidates: the ball where it is expected, else all that looks like it.

        Args:
            picture: RGB, shape (H, W, 3).
            expected_px: where it was found before its appearance was known, shape (2,).
            still_px: where it may be held or lie, shape (2,); NaN where it is known to fly.
        """
        if self.appearance is None:
            return coloured_blobs(picture, self.background, self.ball, self.allowed)
        gain = self.background.gain(picture)
        height, width = picture.shape[:2]
        placed: list[Placing] = []
        for x, y, grown in self._starts(picture, self.appearance, expected_px, still_px):
            fit = self.appearance.place(picture, self.background, gain, x, y, grown, placed)
            if fit is None:
                continue
            if self.allowed is not None:
                row, column = round(fit.y), round(fit.x)
                if not (0 <= row < height and 0 <= column < width and self.allowed[row, column]):
                    continue
            if any(other.is_near(fit.x, fit.y) for other in placed):
                continue
            placed.append(fit)
            if fit.misfit < _SURE:
                break
        positions = np.array([(fit.x, fit.y) for fit in placed]).reshape(-1, 2)
        radii = np.array([fit.radius_px for fit in placed])
        colours = np.zeros((len(placed), 3))
        for at, fit in enumerate(placed):
            half = max(1, round(_MIDDLE * fit.radius_px))
            rows = slice(max(round(fit.y) - half, 0), round(fit.y) + half + 1)
            columns = slice(max(round(fit.x) - half, 0), round(fit.x) + half + 1)
            part = picture[rows, columns]
            if part.size:
                colours[at] = part.reshape(-1, 3).mean(axis=0)
        far = np.array([width, height]) - 1 - radii[:, None]
        whole = np.array(np.all((positions >= radii[:, None]) & (positions <= far), axis=1))
        misfits = np.array([fit.misfit for fit in placed])
        return Blobs(positions, np.pi * radii**2, colours, whole, misfits)

    def _starts(
        self, picture: Picture, appearance: Appearance, expected_px: Array, still_px: Array
    ) -> Iterator[tuple[float, float, float]]:
        """Where it may be, the likeliest first: x, y [px], and how much it has grown."""
        around = [(float(x), float(y)) for x, y in (expected_px, still_px) if np.isfinite(x)]
        if len(around) > 1 and math.dist(*around) < appearance.radius_px:
            del around[1]
        for x, y in around:
            yield x, y, 1.0
        for x, y in around:
            for near in _alike(appearance, picture, x, y):
                yield *near, 1.0
        found = coloured_blobs(picture, self.background, self.ball, self.allowed)
        unlike = np.linalg.norm(found.colours - self.ball.colour, axis=1) / _COLOUR
        unlike += np.abs(np.log(found.areas_px / self.ball.area_px))
        for at in np.argsort(unlike)[:_MOST_STARTS]:
            grown = float(np.clip(np.sqrt(found.areas_px[at] / self.ball.area_px), *_GROWN))
            yield float(found.places_px[at, 0]), float(found.places_px[at, 1]), grown


def _alike(ball: Appearance, picture: Picture, x: float, y: float) -> list[tuple[float, float]]:
    """Where near a position the picture is most like the ball, the best first: x and y [px].

    By template matching of the masked ball, squared differences, in a reduced picture.
    """
    import cv2

    half = int(np.ceil(_SURROUNDINGS * ball.radius_px)) + 2
    left, top = max(round(x) - half, 0), max(round(y) - half, 0)
    part = picture[top : max(round(y) + half + 1, 0), left : max(round(x) + half + 1, 0)]
    coarse = min(1.0, _COARSE_PX / ball.radius_px)
    own = ball.layers
    side = max(3, round(own.shape[0] * (coarse / ball.zoom)))
    if side < own.shape[0]:
        reduced = cv2.resize(own, (side, side), interpolation=cv2.INTER_AREA)
        own = np.asarray(reduced, np.float32)
    size = (round(part.shape[1] * coarse), round(part.shape[0] * coarse))
    if min(size) <= own.shape[0]:
        return []
    small = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.float32)
    fraction = np.repeat(own[:, :, 3:], 3, axis=2)
    colours = own[:, :, :3] / np.maximum(fraction, 1e-3)
    off = np.array(cv2.matchTemplate(small, colours, cv2.TM_SQDIFF, mask=fraction))
    found = []
    middle = (own.shape[0] - 1) / 2
    near = int(_COARSE_PX)
    for _ in range(_LIKELIEST):
        row, column = np.unravel_index(int(off.argmin()), off.shape)
        x_px = (column + middle + 0.5) / coarse - 0.5 + left
        y_px = (row + middle + 0.5) / coarse - 0.5 + top
        found.append((x_px, y_px))
        rows = slice(max(row - near, 0), row + near + 1)
        off[rows, max(column - near, 0) : column + near + 1] = np.inf
    return found
