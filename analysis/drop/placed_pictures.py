"""Placement of pictures whose stamps the arrival leaves open, by the ball's motion.

Where pictures are lost on their way, those around the loss may be a tick earlier or later. A ball
that falls is elsewhere a tick later, so its flight in the other pictures shows which.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.film import FilmedDrop, find_filmed_drop
from analysis.tracking.track import Track
from recorders.simulators.balls import Ball
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError
from tunenet_logs.late_stamps import CorrectedStamps

_ROUNDS = 2
_MIN_PX = 0.3  # standard deviation of a place, at least
_MAX_COST = 12.0  # log likelihood that a single place may cost: a wrong one is not the ball's
_AFTER_RELEASE = -0.95  # fall times from which on the ball flies for sure


def placed_by_motion(
    track: Track, arrivals: CorrectedStamps, start_ns: int, ball: Ball | None
) -> tuple[Track, CorrectedStamps]:
    """Place unsure pictures of a track, and its stamps, where the ball's flight wants them.

    Both are unchanged where no picture is unsure, or no drop is found. `track` is at the corrected
    stamps of `arrivals`, which are of all pictures.
    """
    numbers = np.searchsorted(arrivals.stamps_ns, track.stamps_ns)
    for _ in range(_ROUNDS):
        clock = arrivals.clock
        if clock is None or not clock.unsure.any():
            break
        film = _film_of(track, clock.unsure[numbers], start_ns, ball)
        if film is None:
            break
        along = np.full(len(clock.ticks), np.nan)
        along[numbers] = -(track.places_px @ film.down_px)
        since_s = float(clock.arrivals_ns[0] - start_ns) * 1e-9

        def cost(
            asked: NDArray[np.intp],
            times_ms: Array,
            *,
            film: FilmedDrop = film,
            along: Array = along,
            since_s: float = since_s,
        ) -> Array:
            return _misfit(film, along[asked], since_s + 1e-3 * times_ms)

        placed = clock.placed_by(cost)
        arrivals = replace(arrivals, clock=placed, stamps_ns=placed.stamps_ns)
        track = replace(track, stamps_ns=arrivals.stamps_ns[numbers])
    return track, arrivals


def _film_of(
    track: Track, unsure: NDArray[np.bool_], start_ns: int, ball: Ball | None
) -> FilmedDrop | None:
    """Fit the drop to the sure pictures, or to all where those are too few."""
    sure = replace(track, places_px=np.where(unsure[:, None], np.nan, track.places_px))
    for tried in (sure, track):
        try:
            return find_filmed_drop(tried, start_ns, ball)
        except NotFoundError:
            continue
    return None


def _misfit(film: FilmedDrop, along: Array, seconds: Array) -> Array:
    """Return the negative log likelihood of places (N,) at times (N, S); 0 where nothing flies."""
    flat, fit = seconds.ravel(), film.projection
    times = fit.fall_times(flat)
    heights = fit.bounce.heights(np.maximum(times, _AFTER_RELEASE))
    off = (fit.positions(heights, flat).reshape(seconds.shape) - along[:, None]) / max(
        fit.residual_rms, _MIN_PX
    )
    cost = np.minimum(0.5 * off**2, _MAX_COST)
    flies = (times >= _AFTER_RELEASE) & (flat <= film.end_s)
    return np.where(flies.reshape(seconds.shape) & np.isfinite(off), cost, 0.0)
