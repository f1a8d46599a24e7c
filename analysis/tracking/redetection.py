"""A second look at all pictures, once a flight is known: for what flew, by how it looks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.appearance import Appearance, Placing
from analysis.tracking.arcs import Arc
from analysis.tracking.background import Background, without_ball
from analysis.tracking.candidates import Blobs, Candidates, ColorAndSize, coloured_blobs
from analysis.tracking.following import (
    color_and_size,
    flying,
    follow,
    possible_positions,
    still_positions,
)
from analysis.tracking.learning import learn_appearance
from analysis.tracking.pictures import Pictures
from tunenet_logs.arrays import Array, Picture

_SURE = 0.3
"""Misfit of a `Placing` below which nothing better is looked for."""

_GOOD = 0.4
"""Misfit of a `Placing` up to which it tells whether the ball stands still."""

_MOST_STARTS = 3
"""Blobs of the ball's colour that a fit starts from: each costs a fit."""

_GROWN = (0.65, 1.5)
"""Least and most of such a start's radius over the ball's: a blob may be cut, or have grown
together with something else."""

_COLOUR = 45.0
"""Difference in RGB (0 to 255) that makes a start as unlikely as an area e times as large."""

_MIDDLE = 0.6
"""Of the radius: half the side of a square that lies within the ball."""

_HIDDEN = 2.5
"""Radii around the ball that the background is not learnt from: its shadow, and an error of its
position."""

_MISSED = 1.2
"""A learnt radius over the first one, above which the ball stood out by a part of it alone, and too
little was kept out of the background."""

_MOVED_PX, _STOOD_PX = 1.0, 0.5
"""Least way of a ball that moves, and most of one that stands: several times the noise."""

_ONWARD = 0.8
"""Cosine between the way that came and the one that went on: a bounce turns, flight goes on."""

_SAME = 10
"""Of 255, in the mean of three by three pixels: less is no change."""


@dataclass(frozen=True, eq=False)
class Redetection:
    """Candidates of T pictures, by how the ball looks.

    Attributes:
        table: candidates of every picture.
        before_px: where the first look saw the ball, gaps filled, shape (T, 2).
        unchanged: whether a picture is, around the ball, the one before once more, shape (T,).
    """

    table: Candidates
    before_px: Array
    unchanged: NDArray[np.bool_]

    def new_frames(self) -> NDArray[np.intp]:
        """Numbers of the pictures but those that show a moving ball where it was, once more.

        Phones double pictures, and cameras freeze. A ball that lies moves neither before nor after;
        one that bounces may be seen twice in one place, but goes back.
        """
        table = self.table
        kept = np.ones(len(self.unchanged), dtype=bool)
        if not table.areas_px.size:
            return np.flatnonzero(kept)
        misfits = np.where(np.isfinite(table.areas_px), table.misfits, np.inf)
        best = misfits.argmin(axis=1)
        rows = np.arange(len(best))
        positions = table.places_px[rows, best].copy()
        positions[misfits[rows, best] > _GOOD] = np.nan
        found = np.flatnonzero(np.isfinite(positions[:, 0]))
        edges = np.diff(np.concatenate([[False], self.unchanged, [False]]).astype(int))
        for first, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
            earlier, later = found[found < first], found[found >= end]
            if len(earlier) < 2 or not len(later):
                continue
            before, here, after = positions[[earlier[-2], earlier[-1], later[0]]]
            came, went = here - before, after - here
            stood = np.linalg.norm(positions[first:end] - here, axis=1).max() < _STOOD_PX
            least = min(np.linalg.norm(came), np.linalg.norm(went))
            onward = came @ went > _ONWARD * np.linalg.norm(came) * np.linalg.norm(went)
            kept[first:end] = not (stood and least > _MOVED_PX and onward)
        return np.flatnonzero(kept)


def redetect(
    pictures: Pictures, first: Candidates, arc: Arc, allowed: Picture | None
) -> Redetection:
    """Learn the ball's appearance and the background without it, and find it in all pictures.

    Args:
        pictures: all of them.
        first: candidates by their motion alone.
        arc: the flight among them.
        allowed: see `Pictures.allowed`.
    """
    ball = color_and_size(first, arc)
    chosen, _ = follow(first, arc, ball)
    seen_px = picked(first.places_px, chosen)
    every = np.arange(len(seen_px))
    known = np.flatnonzero(np.isfinite(seen_px[:, 0]))
    before_px = np.column_stack([np.interp(every, known, seen_px[known, i]) for i in (0, 1)])
    areas = picked(first.areas_px, chosen)
    shown, end = flying(arc, chosen, before_px, ball)
    still_px = still_positions(first.seconds, arc, before_px, end)
    crops = pictures.some(shown)
    samples = [*pictures.samples, *crops]
    numbers = [*pictures.sampled, *shown]
    maybe_px = [possible_positions(at, arc, before_px, still_px, ball) for at in numbers]
    clear = without_ball(samples, maybe_px, _HIDDEN * ball.radius_px + 2)
    appearance = learn_appearance(crops, clear, before_px[shown], areas[shown])
    if appearance is not None and appearance.radius_px > _MISSED * ball.radius_px:
        clear = without_ball(samples, maybe_px, _HIDDEN * appearance.radius_px + 2)
        appearance = learn_appearance(crops, clear, before_px[shown], areas[shown])
    del crops, samples  # many whole pictures
    detector = BallDetector(clear, ball, appearance, allowed)
    blobs: list[Blobs] = []
    unchanged = np.zeros(len(before_px), dtype=bool)
    before: Picture | None = None
    for number, picture in enumerate(pictures):
        blobs.append(detector.find(picture, before_px[number], still_px[number]))
        unchanged[number] = before is not None and _is_same(before, picture, blobs[-1])
        before = picture
    return Redetection(Candidates.of(first.seconds, blobs), before_px, unchanged)


def picked(values: Array, chosen: NDArray[np.intp]) -> Array:
    """The chosen candidate's value in each picture; NaN for none.

    Args:
        values: of M candidates in T pictures, shape (T, M) or (T, M, K).
        chosen: number of one, or -1, shape (T,).

    Returns:
        Shape (T,) or (T, K).
    """
    found = values[np.arange(len(chosen)), np.maximum(chosen, 0)].astype(np.float64)
    found[chosen < 0] = np.nan
    return found


def _is_same(before: Picture, picture: Picture, found: Blobs) -> bool:
    """Whether nothing has changed around the likeliest candidate."""
    import cv2

    if not len(found):
        return False
    best = int(found.misfits.argmin())
    half = int(np.ceil(1.5 * np.sqrt(found.areas_px[best] / np.pi))) + 2
    column, row = (int(value) for value in np.round(found.places_px[best]))
    part = (
        slice(max(row - half, 0), row + half + 1),
        slice(max(column - half, 0), column + half + 1),
    )
    if not picture[part].size:
        return False
    off = cv2.absdiff(cv2.blur(before[part], (3, 3)), cv2.blur(picture[part], (3, 3)))
    return int(np.asarray(off).max()) < _SAME


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
        placed: list[Placing] = []
        for x, y, grown in self._starts(picture, self.appearance, expected_px, still_px):
            fit = self.appearance.place(picture, self.background, gain, x, y, grown, placed)
            if fit is None or not self._is_allowed(fit):
                continue
            if any(other.is_near(fit.x, fit.y) for other in placed):
                continue
            placed.append(fit)
            if fit.misfit < _SURE:
                break
        return _blobs(picture, placed)

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
            for near in appearance.alike(picture, x, y):
                yield *near, 1.0
        found = coloured_blobs(picture, self.background, self.ball, self.allowed)
        unlike = np.linalg.norm(found.colours - self.ball.colour, axis=1) / _COLOUR
        unlike += np.abs(np.log(found.areas_px / self.ball.area_px))
        for at in np.argsort(unlike)[:_MOST_STARTS]:
            grown = float(np.clip(np.sqrt(found.areas_px[at] / self.ball.area_px), *_GROWN))
            yield float(found.places_px[at, 0]), float(found.places_px[at, 1]), grown

    def _is_allowed(self, fit: Placing) -> bool:
        if self.allowed is None:
            return True
        height, width = self.allowed.shape
        row, column = round(fit.y), round(fit.x)
        return 0 <= row < height and 0 <= column < width and bool(self.allowed[row, column])


def _blobs(picture: Picture, placed: list[Placing]) -> Blobs:
    """Fitted balls as candidates, each with the mean colour of its middle."""
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
    height, width = picture.shape[:2]
    far = np.array([width, height]) - 1 - radii[:, None]
    whole = np.array(np.all((positions >= radii[:, None]) & (positions <= far), axis=1))
    misfits = np.array([fit.misfit for fit in placed])
    return Blobs(positions, np.pi * radii**2, colours, whole, misfits)
