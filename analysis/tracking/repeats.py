"""Detection of repeated pictures, which show a moving ball where it was.

Phones double pictures, and cameras freeze. The pictures alone decide, so that a film is the same
film from its file, from a log and from a bag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.candidates import Blobs
from tunenet_logs.arrays import Array, Picture

_SAME = 10  # of 255, in the mean of three by three pixels: less is no change
# Of the larger change before or after: a codec refines a picture that comes twice, by .02 to .2 of
# what it changes where the ball has moved.
_LITTLE = 0.3

# Least way of a ball that moves, and most of one that stands: several times the noise.
_MOVED_PX, _STOOD_PX = 1.0, 0.5

# Cosine between the way that came and the one that went on: a bounce turns, flight goes on.
_ONWARD = 0.8

# Times that a ball that goes on is seen once more where it was, and their share of the steps that
# it moves, from which on a recording is one that doubles pictures.
_HABIT, _HABITUAL = 3, 0.02


def change_around(before: Picture, picture: Picture, found: Blobs) -> tuple[float, float]:
    """Measure a picture's change from the one before around its likeliest candidate, of 255.

    Returns:
        The largest and the rms difference of smooth pixels; NaN where there is no candidate.
    """
    import cv2

    if not len(found.areas_px):
        return np.nan, np.nan
    best = int(found.misfits.argmin())
    half = int(np.ceil(1.5 * np.sqrt(found.areas_px[best] / np.pi))) + 2
    column, row = (int(value) for value in np.round(found.places_px[best]))
    part = (
        slice(max(row - half, 0), row + half + 1),
        slice(max(column - half, 0), column + half + 1),
    )
    if not picture[part].size:
        return np.nan, np.nan
    off = np.asarray(cv2.absdiff(cv2.blur(before[part], (3, 3)), cv2.blur(picture[part], (3, 3))))
    return float(off.max()), float(np.sqrt(np.mean(np.square(off, dtype=np.float32))))


def repeated(changes: Array) -> NDArray[np.bool_]:
    """Return whether each picture is, around the ball, the one before once more, shape (T,).

    Args:
        changes: largest and rms change of each picture, see `change_around`; NaN where that is not
            known, as of the first; shape (T, 2).
    """
    largest, rms = changes.T
    around = np.concatenate([[0.0], np.nan_to_num(rms), [0.0]])
    return (largest < _SAME) | (rms < _LITTLE * np.maximum(around[:-2], around[2:]))


def new_pictures(places_px: Array, unchanged: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Select the pictures but those that show a moving ball where it was, once more.

    A ball that lies moves neither before nor after; one that bounces may be seen twice in one place
    by chance, but goes back. Where a recording doubles pictures of a ball that goes on, it is no
    chance, and those of one that turns back are left out, too. A longer run than it makes of one
    picture, or of two of a ball at the top of its flight, shows a ball that lies.

    Args:
        places_px: of the ball in T pictures, NaN where it is not known, shape (T, 2).
        unchanged: whether a picture is, around the ball, the one before once more, shape (T,).

    Returns:
        Their numbers, shape (N,).
    """
    runs = _runs(unchanged)
    repeats = [run for run in runs if _goes_on(places_px, *run)]
    moves = np.linalg.norm(np.diff(places_px, axis=0), axis=1) > _MOVED_PX
    if len(repeats) >= max(_HABIT, _HABITUAL * np.count_nonzero(moves)):
        most = 2 * max(end - first for first, end in repeats) + 1
        repeats += [(first, end) for first, end in runs if end - first <= most]
    kept = np.ones(len(unchanged), dtype=bool)
    for first, end in repeats:
        kept[first:end] = False
    return np.flatnonzero(kept)


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first index of each run of set flags, and the one behind its last."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(int))
    firsts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return list(zip(firsts.tolist(), ends.tolist(), strict=True))


def _goes_on(places_px: Array, first: int, end: int) -> bool:
    """Return whether a ball stands in a run of pictures, and then goes on as it came."""
    found = np.flatnonzero(np.isfinite(places_px[:, 0]))
    earlier, later = found[found < first], found[found >= end]
    if len(earlier) < 2 or not len(later):
        return False
    before, here, after = places_px[[earlier[-2], earlier[-1], later[0]]]
    came, went = here - before, after - here
    stood = np.linalg.norm(places_px[first:end] - here, axis=1).max() < _STOOD_PX
    least = min(np.linalg.norm(came), np.linalg.norm(went))
    onward = came @ went > _ONWARD * np.linalg.norm(came) * np.linalg.norm(went)
    return bool(stood and least > _MOVED_PX and onward)
