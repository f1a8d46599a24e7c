"""Reasons why a track is no drop's, in words that say what to do."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bounce_model import BounceSamples
from analysis.drop.film_search import MIN_SAMPLES
from analysis.tracking.track import Track

# Fraction of a way that is free flight below which nothing is let go, and windows of it that tell:
# short flights of a dull ball fill few.
MIN_FREE, ENOUGH_WINDOWS = 0.1, 20

# Px and radii, of which the larger is how far a fall sags in a window: more than noise does.
_SAG_PX, _SAG = 3.0, 0.3

# Px and radii, of which the larger is how far what moves goes in a window.
_MOVES_PX, _MOVES = 2.0, 0.2

_LIKE_GRAVITY = 0.4  # of the flight's own acceleration, within which another window's is the same
_APART = 3  # Windows between two flights: fewer are a wrong position
_ONE_FLIGHT = 0.6  # fraction of the windows that are one flight, if nothing else happens
_ROLLS = 3.0  # times as far across as along the image's vertical: it rolls
_GAP = 1.9  # periods: a longer one is without a picture of the ball
# Radii from the edge of a picture, at least: a falling ball is out of it one picture later.
_AT_EDGE = 2.0


@dataclass(frozen=True)
class FreeFlight:
    """Share of a track that is free flight.

    Attributes:
        windows: short parts of the way in which the ball moves, one about each picture.
        share: of them that bend as the flight does by which the ball was found.
        flights: how many there are, one after another.
    """

    windows: int
    share: float
    flights: int

    @property
    def is_carried(self) -> bool:
        """Whether the ball is carried by a hand, or rolls."""
        return self.windows >= ENOUGH_WINDOWS and self.share < MIN_FREE


def free_flight(track: Track, chosen: NDArray[np.bool_] | None = None) -> FreeFlight:
    """Compare accelerations in short windows of the `chosen` pictures, (T,), with the flight's."""
    known = np.flatnonzero(track.found if chosen is None else track.found & chosen)
    if len(known) < MIN_SAMPLES:
        return FreeFlight(0, 0.0, 0)
    seconds, places = track.stamps_ns[known] * 1e-9, track.places_px[known]
    radius = float(np.nanmedian(track.radius_px[known]))
    gravity = float(np.linalg.norm(track.gravity_px))
    period_s = float(np.median(np.diff(seconds)))
    wide_s = np.sqrt(8 * max(_SAG_PX, _SAG * radius) / gravity)
    half = max(2, round(wide_s / period_s / 2))
    free: list[bool] = []
    for middle in range(half, len(seconds) - half):
        part = slice(middle - half, middle + half + 1)
        clock, way = seconds[part] - seconds[middle], places[part]
        gapped = float(np.ptp(clock)) > 3 * half * period_s
        if gapped or np.linalg.norm(np.ptp(way, axis=0)) < max(_MOVES_PX, _MOVES * radius):
            continue
        bend = 2 * np.polyfit(clock, way, 2)[0] - track.gravity_px
        free.append(bool(np.linalg.norm(bend) < _LIKE_GRAVITY * gravity))
    runs = [(is_free, len(list(run))) for is_free, run in groupby(free)]
    parted = [is_free or length >= _APART for is_free, length in runs]
    kinds = [is_free for (is_free, _), kept in zip(runs, parted, strict=True) if kept]
    flights = sum(kind for kind, _ in groupby(kinds))
    return FreeFlight(len(free), sum(free) / max(len(free), 1), flights)


def too_small(track: Track, span: float) -> str:
    """Explain that the ball moves by only `span` px along the image's vertical."""
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    across = track.places_px[track.found] @ np.array([down[1], -down[0]])
    wide_px = float(np.ptp(across))
    if wide_px > _ROLLS * max(span, 1.0) and wide_px > 4 * np.nanmedian(track.radius_px):
        return (
            f"the ball never falls: it goes {wide_px:.0f} px across the picture and {span:.0f} "
            "px down, as a ball that rolls, or is filmed from above; at the next drop: let it fall "
            "onto the table, filmed from the side"
        )
    return f"the ball moves by only {span:.0f} px; at the next drop: film it larger, from closer"


def why_not(track: Track, whole: BounceSamples, impacts: list[int], *, fitted: bool) -> str:
    """Explain why no bounce could be fitted; `fitted` if any impact follows a free fall."""
    flight = free_flight(track)
    one_flight = flight.flights == 1 and flight.share > _ONE_FLIGHT
    if flight.is_carried:
        return (
            "no bounce is seen: the ball hardly flies, it is carried, held or rolls (free flight "
            f"in {100 * flight.share:.0f} % of its way); at the next drop: let go above the "
            "table, in view, the camera still"
        )
    if impacts and _leaves_at(track, whole, impacts[0]):
        return (
            "no bounce is seen: the ball falls out of the picture, and where it hits is not in "
            "view; at the next drop: keep the table in view"
        )
    if not impacts or one_flight:
        return (
            "no bounce is seen: the ball never falls onto anything in view; at the next drop: "
            "keep the table in view"
        )
    after = len(whole.seconds) - impacts[-1]
    if len(impacts) == 1 and after < MIN_SAMPLES:
        return (
            f"the recording, or what is seen of the ball, ends {after} pictures after the impact; "
            "at the next drop: record until the ball lies still, all in view"
        )
    if not fitted:
        return (
            "no free fall is seen before an impact (carried, caught, or too few pictures); at the "
            "next drop: let go above the table, in view, and record until the ball lies still"
        )
    return (
        "what the ball does is no drop: it does not bounce along parabolas of one acceleration; at "
        "the next drop: let it bounce on a flat table, untouched, the camera still"
    )


def _leaves_at(track: Track, whole: BounceSamples, impact: int) -> bool:
    """Return whether a fall ends at the picture's edge, without the ball about its end."""
    seconds = whole.seconds
    gap_s = np.diff(seconds[max(impact - 1, 0) : impact + 2]).max(initial=0.0)
    if gap_s < _GAP * float(np.median(np.diff(seconds))):
        return False
    down = track.gravity_px / np.linalg.norm(track.gravity_px)
    axis = int(np.argmax(np.abs(down)))
    low = track.places_px[track.found][max(impact - 2, 0) : impact + 2, axis]
    edge = track.size_px[axis] - 1 if down[axis] > 0 else 0
    near_px = max(_AT_EDGE * float(np.nanmedian(track.radius_px)), np.abs(np.diff(low)).max())
    return bool(np.abs(low - edge).min() < near_px)
