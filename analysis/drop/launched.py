"""Drops that do not begin at rest: thrown, dribbled, rolled off an edge, or bouncing before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.drop.flights import Chain, chains_in, surely_free
from analysis.drop.free_fall import Drop
from analysis.drop.impact import Impact, Indices, gravity_of, meet
from analysis.drop.positions_fit import fit_positions, noise_floor
from tunenet_logs.arrays import Array

_MAX = 40  # chains of bounces in one recording; more tell nothing new
# Times that either end is cut, by how much of its flight, and samples that stay on either side.
_MAX_CUTS, _CUT, _MIN_COUNT = 5, 0.14, 6

# Unknowns of a bounce that a flight tells, standard errors of a residual's size, and what a cut has
# to gain of its logarithm.
_FREE, _CHANCE, _GAIN = 5, 2.0, 0.05

# Fall times from an impact between which a flight is surely free, and that a touch may last to
# either side.
_BESIDE, _MAX_TOUCH = (0.06, 0.4), 0.06

# Fall times, and sample periods: what holds a ball for longer is a hand.
_HELD_ON, _HELD_PERIODS = 0.1, 2.2

# Of the drop height, and of the noise, below the contact: no table lets a ball go there.
_SUNK, _SUNK_SDS = 0.02, 4.0

# Of the drop height, and of the noise: a sample farther from its flight touches the ground.
_CLOSE, _CLOSE_SDS = 5e-4, 3.0

_ODD_GRAVITY = 0.3  # fraction off gravity from which a short fall and flight tell none of their own
_MIN_SAMPLES = 12  # of a chain: eight unknowns of which three have priors, and a noise


def launched_drops(seconds: Array, heights_m: Array, gravity: float, noise_m: float) -> list[Drop]:
    """Find all bounces between free flights, those that follow each other freely as one drop.

    Args:
        seconds: shape (T,), increasing.
        heights_m: along what is up, shape (T,).
        gravity: of the free flights [m/s²].
        noise_m: standard deviation of a height there.
    """
    chains = chains_in(seconds, heights_m, gravity, noise_m)[:_MAX]
    found = [_drop(seconds, heights_m, chain, gravity, noise_m) for chain in chains]
    return [_without_hands(drop) for drop in found if drop is not None]


def _without_hands(drop: Drop) -> Drop:
    """Trim what no ball does at either end, where a hand is only beginning to touch it."""
    best, least = drop, _misfit(drop)
    for from_start in (True, False):
        kept = best
        for _ in range(_MAX_CUTS):
            if least < 0.0:
                return best
            kept = _cut(kept, from_start)
            if kept is None:
                break
            misfit = _misfit(kept)
            if misfit < least - _GAIN:
                best, least = kept, misfit
    return best


def _misfit(drop: Drop) -> float:
    """Return the log of residuals over noise, less what chance makes of it; below 0 if none."""
    fit = fit_positions(drop)
    if fit is None:
        return np.inf
    freedom = max(len(fit.residuals) - _FREE, 1)
    rms = float(np.sqrt(np.sum(fit.residuals**2) / freedom))
    return float(np.log(rms / noise_floor(drop))) - _CHANCE / np.sqrt(2 * freedom)


def _cut(drop: Drop, from_start: bool) -> Drop | None:
    """Trim another part of the fall or of the last flight; None where too little is left."""
    seconds = drop.seconds
    side = seconds < drop.impact_s if from_start else seconds > drop.flight_s[0]
    count = max(1, round(_CUT * np.count_nonzero(side)))
    kept = slice(count, None) if from_start else slice(None, -count)
    left = seconds[kept]
    if (
        min(np.count_nonzero(left < drop.impact_s), np.count_nonzero(left > drop.impact_s))
        < _MIN_COUNT
    ):
        return None
    return replace(
        drop,
        first=drop.first + (count if from_start else 0),
        seconds=left,
        heights_m=drop.heights_m[kept],
        release_s=float(left[0]),
        release_m=float(drop.heights_m[kept][0]),
        fall_s=(max(drop.fall_s[0], float(left[0])), drop.fall_s[1]),
        flight_s=(drop.flight_s[0], min(drop.flight_s[1], float(left[-1]))),
    )


def _drop(
    seconds: Array, heights: Array, chain: Chain, gravity: float, noise: float
) -> Drop | None:
    """Build a drop of one chain; None where it is too short."""
    first, last = surely_free(seconds, heights, chain, gravity, noise)
    at = chain.impacts[0]
    end = min(chain.flights[0], last)
    fall, flight = np.arange(first, at + 1), np.arange(at + 1, end + 1)
    if min(len(fall), len(flight)) < 3 or last + 1 - first < _MIN_SAMPLES:
        return None
    if len(flight) > 4 and len(chain.impacts) > 1:
        flight = flight[:-1]  # the last one may have touched the table
    clock = seconds - seconds[at]
    impact: Impact = meet(clock, heights, fall, flight, noise)
    if not abs(impact.gravity_m_s2 / gravity - 1) < _ODD_GRAVITY:  # too short for one of their own
        impact = _crossing(clock, heights, fall, flight, gravity)
    touching = np.zeros(len(seconds), dtype=bool)
    for index in chain.impacts:
        rows = _touching(seconds, heights, index, (first, last), impact, noise)
        if len(rows) and _holds(seconds, rows, impact):
            return None
        touching[rows] = True
    lowest_m = impact.contact_m - _SUNK * impact.drop_height_m - _SUNK_SDS * noise
    if np.any(heights[flight][~touching[flight]] < lowest_m):
        return None
    part = first + np.flatnonzero(~touching[first : last + 1])
    release_s, release_m = float(seconds[first]), float(heights[first])
    return Drop(
        impact_s=float(seconds[at] + impact.impact_s),
        contact_m=impact.contact_m,
        impact_speed_m_s=impact.impact_speed_m_s,
        flight_restitution=impact.flight_restitution,
        flight_restitution_sd=impact.flight_restitution_sd,
        gravity_m_s2=impact.gravity_m_s2,
        first=first,
        seconds=seconds[part],
        heights_m=heights[part],
        release_s=release_s,
        release_m=release_m,
        flight_gravity_m_s2=gravity_of(clock, heights, flight, noise),
        fall_s=(float(seconds[fall[0]]), float(seconds[fall[-1]])),
        flight_s=(float(seconds[flight[0]]), float(seconds[flight[-1]])),
        noise_m=noise,
        rest_s=float("nan"),
        rest_m=float("nan"),
        rest_tolerance_m=0.0,
        launched=True,
        touching=int(np.count_nonzero(touching[first : last + 1])),
    )


def _holds(seconds: Array, touching: Indices, impact: Impact) -> bool:
    """Return whether the ball is touched for longer than in a bounce."""
    around = np.clip([touching[0] - 1, touching[-1] + 1], 0, len(seconds) - 1)
    longest_s = max(
        _HELD_ON * impact.fall_time_s, _HELD_PERIODS * float(np.median(np.diff(seconds)))
    )
    return float(np.ptp(seconds[around])) > longest_s


def _touching(
    seconds: Array,
    heights: Array,
    index: int,
    ends: tuple[int, int],
    impact: Impact,
    noise: float,
) -> Indices:
    """Return the samples about an impact in which the ball is on the ground, on neither flight.

    A soft ball is there for 10 to 20 ms, of which a fast camera sees many pictures.
    """
    near_s, far_s = (fraction * impact.fall_time_s for fraction in _BESIDE)
    since = seconds - (seconds[index] + seconds[index + 1]) / 2
    inside = np.arange(ends[0], ends[1] + 1)
    longest = _MAX_TOUCH * impact.fall_time_s
    close = _CLOSE * impact.drop_height_m + _CLOSE_SDS * noise
    found: list[Indices] = []
    for side in (-1, 1):
        at = inside[(side * since[inside] > near_s) & (side * since[inside] < far_s)]
        rows = inside[(side * since[inside] > 0) & (side * since[inside] < longest)]
        if len(at) < _MIN_COUNT or not len(rows):
            continue
        curve = np.polyfit(since[at], heights[at], 2)
        off = np.abs(heights[rows] - np.polyval(curve, since[rows])) > close
        rows = rows if side > 0 else rows[::-1]
        off = off if side > 0 else off[::-1]
        count = len(off) if off.all() else int(np.argmin(off))
        found.append(rows[:count])
    return np.sort(np.concatenate(found)) if found else np.arange(0)


def _crossing(
    clock: Array, heights: Array, fall: Indices, flight: Indices, gravity: float
) -> Impact:
    """Intersect two flights of known gravity, on the clock."""
    level = heights + gravity / 2 * clock**2
    (down, below), (up, above) = (np.polyfit(clock[one], level[one], 1) for one in (fall, flight))
    at_s = (below - above) / (up - down)
    fast, slow = -(down - gravity * at_s), up - gravity * at_s
    contact_m = below + down * at_s - gravity / 2 * at_s**2
    nan = float("nan")
    return Impact(
        float(at_s), float(contact_m), float(fast), float(slow / fast), nan, float(gravity)
    )
