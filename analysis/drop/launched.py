"""Find drops that do not begin at rest: thrown, dribbled, rolled off an edge, or bouncing before.

What is free on both sides of an impact measures the restitution, however the ball came to fly.
A hand is no impact: it holds on, and its motion is no parabola.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.bounce_fit import fit_positions, noise_floor
from tunenet_logs.analysis.drop.film import film_impacts
from tunenet_logs.analysis.drop.free_flight import Drop, Impact, Indices, gravity_of, meet
from tunenet_logs.episode import Array

# ---- Chains of impacts with free flight on both sides, anywhere in a recording

_MIN_RUN = 4  # samples of a free flight beside an impact
# A sample is on a flight within so much noise and this part of the fall that the impact ends.
_RUN_SDS, _RUN_OFF = 5.0, 4e-3

# Samples from which on a flight's own curvature is fitted, and how much of gravity it may be: the
# air takes from a fall and adds to a rise.
_OWN_CURVE, _BENT = 8, (0.7, 1.35)

# Standard error of a flight's acceleration, of gravity's, from which on it may be anything.
_UNSURE = 0.15

# The same where a flight may end in a hand.
_SURE_RUN_SDS, _SURE_RUN_OFF, _SURELY_BENT = 3.0, 1e-3, (0.85, 1.15)

_UNSEEN_SDS = 2.0  # standard deviations of the noise within which a hand's beginning is not seen
_MISSES = 3  # samples in a row off a flight, after which it is over
# Sample periods, and fall times, that an impact may last: a hand holds on for longer.
_TOUCH_PERIODS, _TOUCH_FALLS = 3.5, 0.12

_SHORT_TOUCH = 0.03  # of the flights on both sides: what is shorter may all be a touch
_BOUNCIEST = 1.0  # restitution from which on something pushes


@dataclass(frozen=True, eq=False)
class Chain:
    """Impacts with free flight before, between and after them.

    Attributes:
        first: index of the first sample of the free flight before the first impact.
        last: index of the last sample of the free flight after the last one.
        impacts: samples at which falls end.
        falls: index of the first sample of each fall that is free.
        flights: index of the last sample of each flight that is free.
    """

    first: int
    last: int
    impacts: tuple[int, ...]
    falls: tuple[int, ...]
    flights: tuple[int, ...]


def chains_in(seconds: Array, heights: Array, gravity: float, noise: float) -> list[Chain]:
    """Find impacts with free flight on both sides, those with nothing else between as one chain.

    Args:
        seconds: shape (T,), increasing.
        heights: along what is up, shape (T,).
        gravity: in their units.
        noise: standard deviation of a height.
    """
    chains: list[Chain] = []
    end = 0
    for index in film_impacts(seconds, heights, noise) if len(seconds) > 2 * _MIN_RUN else []:
        found = _impact_at(seconds, heights, index, end, gravity, noise)
        if found is None:
            continue
        first, at, last = found
        if chains and first <= chains[-1].last + 1:
            before = chains[-1]
            chains[-1] = Chain(
                before.first,
                last,
                (*before.impacts, at),
                (*before.falls, first),
                (*before.flights, last),
            )
        else:
            chains.append(Chain(first, last, (at,), (first,), (last,)))
        end = at
    return chains


def _impact_at(
    seconds: Array, heights: Array, index: int, start: int, gravity: float, noise: float
) -> tuple[int, int, int] | None:
    """Return the fall's first sample and last, and the flight's last; None where none meet."""
    low = index - 1 + int(np.argmin(heights[max(index - 1, 0) : index + 2]))
    best: tuple[tuple[float, int], tuple[int, int, int]] | None = None
    for before in range(low - 2, low + 2):
        for after in range(before + 1, min(before + 4, len(heights) - _MIN_RUN)):
            if before - start < _MIN_RUN:
                continue
            found = _meets(seconds, heights, (before, after), gravity, noise, start)
            if found is None:
                continue
            first, _, last = found[1]
            between_s = float(seconds[after] - seconds[before])
            is_short = between_s < _SHORT_TOUCH * float(seconds[last] - seconds[first])
            # Of flights as long: without what a soft ball does on the ground.
            score = found[0], after - before if is_short else before - after
            if best is None or score > best[0]:
                best = score, found[1]
    return None if best is None else best[1]


def _meets(
    seconds: Array,
    heights: Array,
    around: tuple[int, int],
    gravity: float,
    noise: float,
    start: int,
) -> tuple[float, tuple[int, int, int]] | None:
    """Return how long both flights are, and their ends, where they meet between two samples."""
    before, after = around
    fall = _line(seconds, heights, np.arange(max(start, before - 5), before + 1), gravity)
    rise = _line(seconds, heights, np.arange(after, min(after + 6, len(heights))), gravity)
    at_s = (seconds[before] + seconds[after]) / 2
    falling, rising = -_slope(fall, at_s), _slope(rise, at_s)
    if not 0.02 * falling < rising < (_BOUNCIEST + 0.1) * falling:
        return None
    depth = falling**2 / (2 * gravity)
    near = _RUN_SDS * noise + _RUN_OFF * depth
    first = _run(seconds, heights, before, -1, start, gravity, near)
    last = _run(seconds, heights, after, 1, len(heights) - 1, gravity, near)
    if first is None or last is None:
        return None
    sides = np.arange(first, before + 1), np.arange(after, last + 1)
    down, up = (_parabola(seconds, heights, rows, gravity) for rows in sides)
    falling, rising = -_slope(down, at_s), _slope(up, at_s)
    if not 0.02 * falling < rising < _BOUNCIEST * falling:
        return None
    gap = _value(up, at_s) - _value(down, at_s)
    meets_s = at_s - gap / (rising + falling)
    period_s = float(np.median(np.diff(seconds[first : last + 1])))
    slack_s = 0.5 * period_s + 4 * noise / (rising + falling)
    if not seconds[before] - slack_s < meets_s < seconds[after] + slack_s:
        return None
    touch_s = max(_TOUCH_PERIODS * period_s, _TOUCH_FALLS * falling / gravity)
    is_brief = seconds[after] - seconds[before] <= touch_s
    if is_brief and all(_is_free(seconds[rows], heights[rows], gravity, noise) for rows in sides):
        return float(last - first), (first, before, last)
    return None


def surely_free(
    seconds: Array, heights: Array, chain: Chain, gravity: float, noise: float
) -> tuple[int, int]:
    """Return the first and last sample of a chain that no hand touches, or is about to."""
    speed = np.ptp(heights[chain.first : chain.last + 1])
    near = _SURE_RUN_SDS * noise + _SURE_RUN_OFF * float(speed)
    before, after = chain.impacts[0], chain.impacts[-1] + 1
    first = _run(seconds, heights, before, -1, chain.first, gravity, near, _SURELY_BENT)
    last = _run(seconds, heights, after, 1, chain.last, gravity, near, _SURELY_BENT)
    unseen_s = float(np.sqrt(2 * _UNSEEN_SDS * noise / gravity))
    first = chain.first if first is None else first
    last = chain.last if last is None else last
    if first > 0:
        first = int(np.searchsorted(seconds, seconds[first] + unseen_s))
    if last < len(seconds) - 2:
        last = int(np.searchsorted(seconds, seconds[last] - unseen_s, side="right")) - 1
    return first, last


def _run(
    seconds: Array,
    heights: Array,
    at: int,
    step: int,
    end: int,
    gravity: float,
    near: float,
    bent: tuple[float, float] = _BENT,
) -> int | None:
    """Extend a free flight from a sample in a direction, to its last; None if too short."""
    count = min(6, abs(end - at) + 1)
    if count < _MIN_RUN:
        return None
    last = at + step * (count - 1)
    while True:
        rows = np.arange(min(at, last), max(at, last) + 1)
        curve = _parabola(seconds, heights, rows, gravity, bent)
        off = np.abs(heights[rows] - np.polyval(curve[:3], seconds[rows] - curve[3]))
        if np.count_nonzero(off > near) > 0.1 * len(rows):
            return None
        ahead = last + step * np.arange(1, max(2, len(rows) // 2) + 1)
        ahead = ahead[(ahead >= min(at, end)) & (ahead <= max(at, end))]
        if not len(ahead):
            return last
        on = np.abs(heights[ahead] - np.polyval(curve[:3], seconds[ahead] - curve[3])) < near
        misses = np.convolve(~on, np.ones(_MISSES), "full")[: len(on)] >= _MISSES
        if misses.any():
            ahead = ahead[: int(misses.argmax())]
            on = on[: len(ahead)]
        if not on.any():
            return last
        reached = int(ahead[np.flatnonzero(on)[-1]])
        if reached == last:
            return last
        last = reached
        if misses.any():
            return last


def _is_free(seconds: Array, heights: Array, gravity: float, noise: float) -> bool:
    """Return whether a flight shows gravity, long enough to: a hand pulls otherwise."""
    if len(seconds) < _MIN_RUN:
        return False
    inverse = np.linalg.pinv(np.vander(seconds - seconds.mean(), 3))
    shown = -2 * float(inverse[0] @ heights) / gravity
    error = 2 * noise * float(np.linalg.norm(inverse[0])) / gravity
    low, high = _BENT
    return error < _UNSURE and low - 2 * error < shown < high + 2 * error


def _line(seconds: Array, heights: Array, rows: NDArray[np.intp], gravity: float) -> Array:
    """Fit a parabola of gravity's curvature: half of it, slope, height and time at the middle."""
    middle = float(seconds[rows].mean())
    since = seconds[rows] - middle
    straight = heights[rows] + gravity / 2 * since**2
    slope, height = np.polyfit(since, straight, 1) if len(rows) > 1 else (0.0, straight[0])
    return np.array([-gravity / 2, slope, height, middle])


def _parabola(
    seconds: Array,
    heights: Array,
    rows: NDArray[np.intp],
    gravity: float,
    bent: tuple[float, float] = _BENT,
) -> Array:
    """Fit the same with its own curvature near gravity's, where the samples are many."""
    if len(rows) < _OWN_CURVE:
        return _line(seconds, heights, rows, gravity)
    middle = float(seconds[rows].mean())
    since = seconds[rows] - middle
    curve = float(np.polyfit(since, heights[rows], 2)[0])
    low, high = bent
    return _line(seconds, heights, rows, float(np.clip(-2 * curve, low * gravity, high * gravity)))


def _slope(curve: Array, at_s: float) -> float:
    return float(curve[1] + 2 * curve[0] * (at_s - curve[3]))


def _value(curve: Array, at_s: float) -> float:
    return float(np.polyval(curve[:3], at_s - curve[3]))


# ---- Drop of each chain, without what a hand touches and the samples on the ground

_MAX = 40  # chains of bounces in one recording; more tell nothing new
# Times that either end is cut, by how much of its flight, and samples that stay on either side.
_MAX_CUTS, _CUT, _MIN_COUNT = 5, 0.14, 6

# Unknowns of a bounce that a flight determines, standard errors of the residuals' rms, and what a
# cut has to gain of its logarithm.
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
