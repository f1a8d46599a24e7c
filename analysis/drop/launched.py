"""Find drops that do not begin at rest: thrown, dribbled, rolled off an edge, or bouncing before.

What is free on both sides of an impact measures the restitution, however the ball came to fly.
A hand is no impact: it holds on, and its motion is no parabola.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tunenet_logs.analysis.drop.bounce_fit import MIN_SAMPLES, fit_positions, noise_floor
from tunenet_logs.analysis.drop.film import film_impacts
from tunenet_logs.analysis.drop.free_flight import Drop, Impact, Indices, gravity_of, meet
from tunenet_logs.episode import Array, median_step

# ---- Chains of impacts with free flight on both sides, anywhere in a recording

_MIN_RUN = 4  # samples of a free flight beside an impact
# Of gravity, a flight's own curvature: the air takes from a fall and adds to a rise.
_BENT = (0.7, 1.35)
_SURELY_BENT = (0.85, 1.15)  # the same where a flight may end in a hand
_MISSES = 3  # samples in a row off a flight, after which it is over
_MIN_COUNT = 6  # samples that stay on either side of an impact


@dataclass(frozen=True, eq=False)
class Chain:
    """Impacts with free flight before, between and after them."""

    first: int  # index of the first sample of the free flight before the first impact
    last: int  # index of the last sample of the free flight after the last one
    impacts: tuple[int, ...]  # samples at which falls end
    flights: tuple[int, ...]  # index of the last sample of each flight that is free


@dataclass(frozen=True, eq=False)
class FlownHeights:
    """Heights in which something may fly freely."""

    seconds: Array  # shape (T,), increasing
    heights: Array  # along what is up, shape (T,)
    gravity: float  # of the free flights, in their units
    noise: float  # standard deviation of a height

    def chains(self) -> list[Chain]:
        """Find impacts with free flight on both sides, those with nothing else between as one."""
        seconds = self.seconds
        chains: list[Chain] = []
        end = 0
        enough = len(seconds) > 2 * _MIN_RUN
        for index in film_impacts(seconds, self.heights, self.noise) if enough else []:
            found = self._impact_at(index, end)
            if found is None:
                continue
            first, at, last = found
            if chains and first <= chains[-1].last + 1:
                before = chains[-1]
                impacts, flights = (*before.impacts, at), (*before.flights, last)
                chains[-1] = Chain(before.first, last, impacts, flights)
            else:
                chains.append(Chain(first, last, (at,), (last,)))
            end = at
        return chains

    def drops(self) -> list[Drop]:
        """Find all bounces between free flights [m, s], those that follow freely as one drop."""
        found = [self._drop(chain) for chain in self.chains()[:40]]  # more tell nothing new
        return [_without_hands(drop) for drop in found if drop is not None]

    def _impact_at(self, index: int, start: int) -> tuple[int, int, int] | None:
        """Return the fall's first sample and last, and the flight's last; None where none meet."""
        seconds, heights = self.seconds, self.heights
        low = index - 1 + int(np.argmin(heights[max(index - 1, 0) : index + 2]))
        best: tuple[tuple[float, int], tuple[int, int, int]] | None = None
        for before in range(low - 2, low + 2):
            for after in range(before + 1, min(before + 4, len(heights) - _MIN_RUN)):
                ends = self._meets(before, after, start) if before - start >= _MIN_RUN else None
                if ends is None:
                    continue
                first, _, last = ends
                between_s = float(seconds[after] - seconds[before])
                # A touch that is short beside both flights may all be one.
                is_short = between_s < 0.03 * float(seconds[last] - seconds[first])
                # Of flights as long: without what a soft ball does on the ground.
                score = float(last - first), after - before if is_short else before - after
                if best is None or score > best[0]:
                    best = score, ends
        return None if best is None else best[1]

    def _meets(self, before: int, after: int, start: int) -> tuple[int, int, int] | None:
        """Return the ends of both flights where they meet between two samples."""
        seconds, heights, gravity, noise = self.seconds, self.heights, self.gravity, self.noise
        fall = self._line(np.arange(max(start, before - 5), before + 1), gravity)
        rise = self._line(np.arange(after, min(after + 6, len(heights))), gravity)
        at_s = (seconds[before] + seconds[after]) / 2
        falling, rising = -_slope(fall, at_s), _slope(rise, at_s)
        if not 0.02 * falling < rising < 1.1 * falling:
            return None
        # So near to its parabola a sample is on a flight: in noise, and parts of the fall.
        near = 5.0 * noise + 4e-3 * (falling**2 / (2 * gravity))
        first = self._run(before, -1, start, near)
        last = self._run(after, 1, len(heights) - 1, near)
        if first is None or last is None:
            return None
        sides = np.arange(first, before + 1), np.arange(after, last + 1)
        down, up = (self._parabola(rows) for rows in sides)
        falling, rising = -_slope(down, at_s), _slope(up, at_s)
        if not 0.02 * falling < rising < falling:  # faster, something pushes
            return None
        gap = _value(up, at_s) - _value(down, at_s)
        meets_s = at_s - gap / (rising + falling)
        period_s = median_step(seconds[first : last + 1])
        slack_s = 0.5 * period_s + 4 * noise / (rising + falling)
        if not seconds[before] - slack_s < meets_s < seconds[after] + slack_s:
            return None
        touch_s = max(3.5 * period_s, 0.12 * falling / gravity)  # a hand holds on for longer
        is_brief = seconds[after] - seconds[before] <= touch_s
        is_flown = is_brief and all(self._is_free(rows) for rows in sides)
        return (first, before, last) if is_flown else None

    def _surely_free(self, chain: Chain) -> tuple[int, int]:
        """Return the first and last sample of a chain that no hand touches, or is about to."""
        seconds = self.seconds
        depth = np.ptp(self.heights[chain.first : chain.last + 1])
        near = 3.0 * self.noise + 1e-3 * float(depth)
        first = self._run(chain.impacts[0], -1, chain.first, near, _SURELY_BENT)
        last = self._run(chain.impacts[-1] + 1, 1, chain.last, near, _SURELY_BENT)
        # Within two standard deviations of the noise a hand's beginning is not seen.
        unseen_s = float(np.sqrt(2 * 2.0 * self.noise / self.gravity))
        first = chain.first if first is None else first
        last = chain.last if last is None else last
        if first > 0:
            first = int(np.searchsorted(seconds, seconds[first] + unseen_s))
        if last < len(seconds) - 2:
            last = int(np.searchsorted(seconds, seconds[last] - unseen_s, side="right")) - 1
        return first, last

    def _run(
        self, at: int, step: int, end: int, near: float, bent: tuple[float, float] = _BENT
    ) -> int | None:
        """Extend a free flight from a sample in a direction, to its last; None if too short."""
        seconds, heights = self.seconds, self.heights
        count = min(6, abs(end - at) + 1)
        if count < _MIN_RUN:
            return None
        last = at + step * (count - 1)
        while True:
            rows = np.arange(min(at, last), max(at, last) + 1)
            curve = self._parabola(rows, bent)
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
            if reached == last or misses.any():
                return reached
            last = reached

    def _is_free(self, rows: Indices) -> bool:
        """Return whether a flight shows gravity, long enough to: a hand pulls otherwise."""
        if len(rows) < _MIN_RUN:
            return False
        seconds, heights = self.seconds[rows], self.heights[rows]
        inverse = np.linalg.pinv(np.vander(seconds - seconds.mean(), 3))
        shown = -2 * float(inverse[0] @ heights) / self.gravity
        error = 2 * self.noise * float(np.linalg.norm(inverse[0])) / self.gravity
        low, high = _BENT
        # With a larger error it may be anything.
        return error < 0.15 and low - 2 * error < shown < high + 2 * error

    def _line(self, rows: Indices, gravity: float) -> Array:
        """Fit a parabola of this gravity: half its curvature, slope, height, time at the middle."""
        seconds = self.seconds[rows]
        middle = float(seconds.sum()) / len(rows)
        since = seconds - middle
        straight = self.heights[rows] + gravity / 2 * since**2
        slope = float(since @ straight) / float(since @ since) if len(rows) > 1 else 0.0
        return np.array([-gravity / 2, slope, float(straight.sum()) / len(rows), middle])

    def _parabola(self, rows: Indices, bent: tuple[float, float] = _BENT) -> Array:
        """Fit the same with its own curvature near gravity's, where the samples are many."""
        gravity = self.gravity
        if len(rows) < 8:
            return self._line(rows, gravity)
        seconds = self.seconds[rows]
        since = seconds - float(seconds.sum()) / len(rows)
        square = since * since
        bend = square - float(square.sum()) / len(rows)  # beside a constant and a slope
        bend -= float(square @ since) / float(square.sum()) * since
        curve = float(bend @ self.heights[rows]) / float(bend @ bend)
        low, high = bent
        return self._line(rows, float(np.clip(-2 * curve, low * gravity, high * gravity)))

    def _drop(self, chain: Chain) -> Drop | None:
        """Build a drop of one chain; None where it is too short."""
        seconds, heights, noise = self.seconds, self.heights, self.noise
        first, last = self._surely_free(chain)
        at = chain.impacts[0]
        end = min(chain.flights[0], last)
        fall, flight = np.arange(first, at + 1), np.arange(at + 1, end + 1)
        if min(len(fall), len(flight)) < 3 or last + 1 - first < MIN_SAMPLES:
            return None
        if len(flight) > 4 and len(chain.impacts) > 1:
            flight = flight[:-1]  # the last one may have touched the table
        clock = seconds - seconds[at]
        impact: Impact = meet(clock, heights, fall, flight, noise)
        # Too short for a gravity of their own.
        if not abs(impact.gravity_m_s2 / self.gravity - 1) < 0.3:
            impact = _crossing(clock, heights, fall, flight, self.gravity)
        touching = np.zeros(len(seconds), dtype=bool)
        for index in chain.impacts:
            rows = self._touching(index, np.arange(first, last + 1), impact)
            if not len(rows):
                continue
            around = np.clip([rows[0] - 1, rows[-1] + 1], 0, len(seconds) - 1)
            # What holds a ball for longer is a hand.
            longest_s = max(0.1 * impact.fall_time_s, 2.2 * median_step(seconds))
            if float(np.ptp(seconds[around])) > longest_s:
                return None
            touching[rows] = True
        # No table lets a ball go there.
        lowest_m = impact.contact_m - 0.02 * impact.drop_height_m - 4.0 * noise
        if np.any(heights[flight][~touching[flight]] < lowest_m):
            return None
        part = first + np.flatnonzero(~touching[first : last + 1])
        return Drop(
            **impact.after(float(seconds[at])),
            first=first,
            seconds=seconds[part],
            heights_m=heights[part],
            release_s=float(seconds[first]),
            release_m=float(heights[first]),
            flight_gravity_m_s2=gravity_of(clock, heights, flight, noise),
            fall_s=(float(seconds[fall[0]]), float(seconds[fall[-1]])),
            flight_s=(float(seconds[flight[0]]), float(seconds[flight[-1]])),
            noise_m=noise,
            launched=True,
            touching=int(np.count_nonzero(touching[first : last + 1])),
        )

    def _touching(self, index: int, inside: Indices, impact: Impact) -> Indices:
        """Return the samples about an impact in which the ball is on the ground, on neither flight.

        A soft ball is there for 10 to 20 ms, of which a fast camera sees many pictures.
        """
        # Between these fall times from an impact a flight is surely free.
        near_s, far_s = (fraction * impact.fall_time_s for fraction in (0.06, 0.4))
        since = self.seconds - (self.seconds[index] + self.seconds[index + 1]) / 2
        # Farther from its flight it touches the ground.
        close = 5e-4 * impact.drop_height_m + 3.0 * self.noise
        found: list[Indices] = []
        for side in (-1, 1):
            at = inside[(side * since[inside] > near_s) & (side * since[inside] < far_s)]
            rows = inside[(side * since[inside] > 0) & (side * since[inside] < near_s)]
            if len(at) < _MIN_COUNT or not len(rows):
                continue
            curve = np.polyfit(since[at], self.heights[at], 2)
            off = np.abs(self.heights[rows] - np.polyval(curve, since[rows])) > close
            rows = rows if side > 0 else rows[::-1]
            off = off if side > 0 else off[::-1]
            count = len(off) if off.all() else int(np.argmin(off))
            found.append(rows[:count])
        return np.sort(np.concatenate(found)) if found else np.arange(0)


def _slope(curve: Array, at_s: float) -> float:
    return float(curve[1] + 2 * curve[0] * (at_s - curve[3]))


def _value(curve: Array, at_s: float) -> float:
    return float(np.polyval(curve[:3], at_s - curve[3]))


def _crossing(
    clock: Array, heights: Array, fall: Indices, flight: Indices, gravity: float
) -> Impact:
    """Intersect two flights of known gravity, on the clock."""
    level = heights + gravity / 2 * clock**2
    (down, below), (up, above) = (np.polyfit(clock[one], level[one], 1) for one in (fall, flight))
    at_s = (below - above) / (up - down)
    fast, slow = -(down - gravity * at_s), up - gravity * at_s
    contact_m = below + down * at_s - gravity / 2 * at_s**2
    found = (float(one) for one in (at_s, contact_m, fast, slow / fast, np.nan, gravity))
    return Impact(*found)


# ---- Ends of a drop that a hand touches


def _without_hands(drop: Drop) -> Drop:
    """Trim what no ball does at either end, where a hand is only beginning to touch it."""
    best, least = drop, _misfit(drop)
    for from_start in (True, False):
        kept = best
        for _ in range(5):
            if least < 0.0:
                return best
            kept = _cut(kept, from_start)
            if kept is None:
                break
            misfit = _misfit(kept)
            if misfit < least - 0.05:  # of the log: 5 % less
                best, least = kept, misfit
    return best


def _misfit(drop: Drop) -> float:
    """Return the log of residuals over noise, less what chance makes of it; below 0 if none."""
    fit = fit_positions(drop)
    if fit is None:
        return np.inf
    freedom = max(len(fit.residuals) - 5, 1)  # unknowns that a flight determines
    rms = float(np.sqrt(np.sum(fit.residuals**2) / freedom))
    return float(np.log(rms / noise_floor(drop))) - 2.0 / np.sqrt(2 * freedom)


def _cut(drop: Drop, from_start: bool) -> Drop | None:
    """Trim another part of the fall or of the last flight; None where too little is left."""
    seconds = drop.seconds
    side = seconds < drop.impact_s if from_start else seconds > drop.flight_s[0]
    count = max(1, round(0.14 * np.count_nonzero(side)))  # in 5 such cuts half of it goes
    kept = slice(count, None) if from_start else slice(None, -count)
    left = seconds[kept]
    before, after = np.count_nonzero(left < drop.impact_s), np.count_nonzero(left > drop.impact_s)
    if min(before, after) < _MIN_COUNT:
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
