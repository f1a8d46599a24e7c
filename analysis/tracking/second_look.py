"""A second look at all pictures, once a flight is known: for what flew, by how it looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.arcs import Arc
from analysis.tracking.background import without_ball
from analysis.tracking.blobs import Blobs
from analysis.tracking.candidates import Candidates, tabulate
from analysis.tracking.following import (
    flying,
    follow,
    hiding_places,
    look_of,
    still_places,
)
from analysis.tracking.learning import learn_appearance
from analysis.tracking.looking import Eye
from analysis.tracking.pictures import Pictures
from tunenet_logs.arrays import Array, Picture

_HIDDEN = 2.5
_MISSED = 1.2
_MOVED_PX, _STOOD_PX, _ONWARD = 1.0, 0.5, 0.8
_GOOD = 0.4
_SAME = 10
"""Of 255, in the mean of three by three pixels: less is no change."""


@dataclass(frozen=True, eq=False)
class SecondLook:
    """What it shows.

    Attributes:
        table: candidates of every picture.
        before_px: where the first look saw the ball, gaps filled, shape (T, 2).
        unchanged: whether a picture is, around the ball, the one before once more, shape (T,).
    """

    table: Candidates
    before_px: Array
    unchanged: NDArray[np.bool_]

    def fresh(self) -> NDArray[np.intp]:
        """Numbers of the pictures but those that show a moving ball where it was, once more.

        Phones double pictures, and cameras freeze. A ball that lies moves neither before nor after;
        one that bounces may be seen twice in one place, but goes back.
        """
        places = self._likeliest_px()
        kept = np.ones(len(self.unchanged), dtype=bool)
        found = np.flatnonzero(np.isfinite(places[:, 0]))
        edges = np.diff(np.concatenate([[False], self.unchanged, [False]]).astype(int))
        for first, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
            earlier, later = found[found < first], found[found >= end]
            if len(earlier) < 2 or not len(later):
                continue
            before, here, after = places[[earlier[-2], earlier[-1], later[0]]]
            came, went = here - before, after - here
            stood = np.linalg.norm(places[first:end] - here, axis=1).max() < _STOOD_PX
            least = min(np.linalg.norm(came), np.linalg.norm(went))
            onward = came @ went > _ONWARD * np.linalg.norm(came) * np.linalg.norm(went)
            kept[first:end] = not (stood and least > _MOVED_PX and onward)
        return np.flatnonzero(kept)

    def _likeliest_px(self) -> Array:
        """The best candidate's place in each picture, NaN where none is good, shape (T, 2)."""
        table = self.table
        if not table.areas_px.size:
            return np.full((len(table.seconds), 2), np.nan)
        misfits = np.where(np.isfinite(table.areas_px), table.misfits, np.inf)
        best = misfits.argmin(axis=1)
        rows = np.arange(len(best))
        places = table.places_px[rows, best].copy()
        places[misfits[rows, best] > _GOOD] = np.nan
        return places


def look_again(
    pictures: Pictures, first: Candidates, arc: Arc, allowed: Picture | None
) -> SecondLook:
    """Learn the ball's own picture and the background without it, and look for it everywhere.

    Args:
        pictures: all of them.
        first: candidates by their motion alone.
        arc: the flight among them.
        allowed: see `Pictures.allowed`.
    """
    look = look_of(first, arc)
    chosen, _ = follow(first, arc, look)
    places = filled(picked(first.places_px, chosen))
    areas = picked(first.areas_px, chosen)
    shown, end = flying(arc, chosen, places, look)
    still = still_places(first.seconds, arc, places, end)
    crops = pictures.some(shown)
    numbers, all_of = [*pictures.sampled, *shown], [*pictures.samples, *crops]
    maybe = [hiding_places(number, arc, places, still, look) for number in numbers]
    clear = without_ball(all_of, maybe, _HIDDEN * look.radius_px + 2)
    ball = learn_appearance(crops, clear, places[shown], areas[shown])
    if ball is not None and ball.radius_px > _MISSED * look.radius_px:
        clear = without_ball(all_of, maybe, _HIDDEN * ball.radius_px + 2)
        ball = learn_appearance(crops, clear, places[shown], areas[shown])
    del crops, all_of  # many whole pictures
    eye = Eye(clear, look, ball, allowed)
    looked: list[Blobs] = []
    unchanged = np.zeros(len(places), dtype=bool)
    before: Picture | None = None
    for at, picture in enumerate(pictures):
        looked.append(eye.find(picture, places[at], still[at]))
        unchanged[at] = before is not None and _same(before, picture, looked[-1])
        before = picture
    return SecondLook(tabulate(first.seconds, looked), places, unchanged)


def picked(values: Array, chosen: NDArray[np.intp]) -> Array:
    """The chosen candidate of each picture; NaN for -1."""
    found = values[np.arange(len(chosen)), np.maximum(chosen, 0)].astype(np.float64)
    found[chosen < 0] = np.nan
    return found


def filled(places: Array) -> Array:
    """Gaps filled, and the ends held."""
    known = np.flatnonzero(np.isfinite(places[:, 0]))
    numbers = np.arange(len(places))
    return np.column_stack([np.interp(numbers, known, places[known, axis]) for axis in (0, 1)])


def _same(before: Picture, picture: Picture, found: Blobs) -> bool:
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
