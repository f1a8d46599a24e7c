"""Find drops in a recorded height: the fall, the first impact, the first flight, the rest.

Between impacts the height is a parabola of one curvature, -g. The fall before an impact and the
flight after it are fitted together; where the two meet is the impact, to a small fraction of a
sample, and the drop height follows from the speed there. Nothing is assumed of g, of the table's
height or of the release: at first the ball may be held, carried or already falling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.drop.impact import falling_to, gravity_of, meet, meet_at
from analysis.drop.segments import (
    MIN_DROP_M,
    fall_samples,
    fit_parabola,
    flight_samples,
    rebounds,
    release,
    rest_and_end,
)
from tunenet_logs.arrays import Array
from tunenet_logs.errors import NotFoundError

_MIN_SAMPLES = 10
_SLOPE_WINDOW_S = 0.025
_NOISE_WINDOW_S = 0.4
_MARGIN_S = 1.0
_MOST_FALL_TIMES = 40
_GRAVITY_M_S2 = 9.81
_ODD_GRAVITY = 0.2


@dataclass(frozen=True, eq=False)
class Drop:
    """One drop.

    Attributes:
        first: index of its first sample in the recording: a second before the release.
        seconds: times of its samples [s], shape (T,); until the ball rests or is lifted again.
        heights_m: heights there [m], shape (T,).
        release_s: when the ball was let go, or would have been for this fall [s].
        release_m: height there [m].
        impact_s: the first impact [s].
        contact_m: height at contact [m].
        impact_speed_m_s: at the first impact, positive.
        flight_restitution: ratio of the speeds after and before, by the parabolas of fall and
            flight alone; NaN where too little of the first flight is seen.
        flight_restitution_sd: its standard error; NaN likewise.
        gravity_m_s2: fitted acceleration of fall and flight together.
        drag: how much slower it falls than it flies, (g_flight - g_fall) / g_flight; NaN likewise.
        drag_sd: its standard error; NaN likewise.
        noise_m: standard deviation of the samples about a smooth curve [m].
        rest_m: height where the ball comes to rest [m]; NaN where it is not seen to.
        rest_tolerance_m: how far from the contact that may be on one table [m].
    """

    first: int
    seconds: Array
    heights_m: Array
    release_s: float
    release_m: float
    impact_s: float
    contact_m: float
    impact_speed_m_s: float
    flight_restitution: float
    flight_restitution_sd: float
    gravity_m_s2: float
    drag: float
    drag_sd: float
    noise_m: float
    rest_m: float
    rest_tolerance_m: float

    @property
    def table_m(self) -> float:
        """Height of the ball on the table [m]: at rest where that is seen, else at contact.

        In a simulator with large steps a ball hits well below that.
        """
        return self.contact_m if np.isnan(self.rest_m) else self.rest_m

    @property
    def fall_time_s(self) -> float:
        """Time of a fall from rest to the impact's speed [s]."""
        return self.impact_speed_m_s / self.gravity_m_s2

    @property
    def drop_height_m(self) -> float:
        """Height of a fall from rest to the impact's speed [m]."""
        return self.impact_speed_m_s**2 / (2 * self.gravity_m_s2)


def find_drops(seconds: Array, heights_m: Array) -> list[Drop]:
    """All drops in a recording, in order; each ends where the ball is lifted again.

    Args:
        seconds: sample times [s], shape (T,), increasing.
        heights_m: heights of the ball [m], shape (T,), up positive, finite.

    Raises:
        NotFoundError: there is none; the message says why.
    """
    if len(seconds) < _MIN_SAMPLES:
        raise NotFoundError(f"{len(seconds)} samples of the ball are too few for a drop")
    noise = noise_of(heights_m)
    span = float(np.ptp(heights_m))
    if span < max(MIN_DROP_M, 20 * noise):
        raise NotFoundError(f"the ball does not fall: it moves by {1000 * span:.1f} mm in all")
    drops: list[Drop] = []
    odd: list[Drop] = []
    reasons: list[str] = []
    end = 0
    for index in impact_candidates(seconds, heights_m):
        if index < end:
            continue
        try:
            drop, drop_end = _fit(seconds, heights_m, end, index, noise)
        except NotFoundError as reason:
            reasons.append(str(reason))
            continue
        if abs(drop.gravity_m_s2 / _GRAVITY_M_S2 - 1) < _ODD_GRAVITY:
            drops.append(drop)
            end = drop_end
        else:  # a hand may lower a ball along a parabola too
            odd.append(drop)
    if not drops and not odd:
        raise NotFoundError(reasons[0] if reasons else "no fall ends in an impact")
    return drops or odd[:1]


def noise_of(heights: Array) -> float:
    """Robust noise from third differences, which a parabola does not have; in the heights' unit."""
    return float(np.median(np.abs(np.diff(heights, 3)))) / (0.6745 * np.sqrt(20.0))


def impact_candidates(seconds: Array, heights: Array) -> list[int]:
    """Samples at which a fast fall ends within a sample or two, in order."""
    width = max(2, round(_SLOPE_WINDOW_S / float(np.median(np.diff(seconds)))))
    if len(heights) <= 2 * width:
        return []
    slopes = run_slopes(seconds, heights, width)
    before, after = slopes[:-width], slopes[width:]  # of sample i + width
    fast = before < 0.12 * min(before.min(), 0.0)
    jump = np.where(fast & (after > 0.5 * before), after - before, 0.0)
    peaks: list[int] = []
    for index in np.flatnonzero(jump > 0.15 * max(jump.max(), 1e-9)):
        if peaks and index - peaks[-1] <= width:
            peaks[-1] = max(peaks[-1], int(index), key=lambda at: jump[at])
        else:
            peaks.append(int(index))
    return [peak + width for peak in peaks]


def run_slopes(seconds: Array, heights: Array, width: int) -> Array:
    """Slope a second of each run of width + 1 samples, between the means of its halves."""
    half = (width + 1) // 2

    def rise(values: Array) -> Array:
        sums = np.concatenate([[0.0], np.cumsum(values - values[0])])
        means = (sums[half:] - sums[:-half]) / half
        return means[width + 1 - half :] - means[: half - width - 1]

    return rise(heights) / rise(seconds)


def _fit(seconds: Array, heights: Array, start: int, index: int, noise: float) -> tuple[Drop, int]:
    """The drop that first hits the table near sample `index`, and the sample where it ends."""
    clock = seconds - seconds[index]
    lately = heights[max(start, int(np.searchsorted(clock, -_NOISE_WINDOW_S))) : index]
    noise = max(noise, noise_of(lately)) if len(lately) >= _MIN_SAMPLES else noise
    fall = fall_samples(clock, heights, start, index, noise)
    parabola = fit_parabola(clock, heights, fall)
    flight = flight_samples(clock, heights, index, parabola, noise)
    if len(flight):
        meeting = meet(clock, heights, fall, flight, noise)
    else:
        near = heights[index - 1 : index + 4]
        meeting = falling_to(float(near.min()), parabola, level_sd=float(np.ptp(near)))
    rest, end = rest_and_end(clock, heights, index, meeting, noise)
    if not len(rest) and not len(flight):
        raise NotFoundError("the recording ends before the ball rebounds")
    level, level_sd = _level(heights[rest])
    tolerance = 4 * meeting.contact_sd_m + 0.001 * meeting.drop_height_m + 0.001
    if abs(level - meeting.contact_m) < tolerance and level_sd < meeting.contact_sd_m:
        meeting = meet_at(level, meeting)
    if not rebounds(clock[:end] - meeting.impact_s, heights[:end], meeting, noise):
        raise NotFoundError("the ball does not bounce: it stays where it lands")
    release_s, release_m = release(clock, heights, start, int(fall[-1]), meeting)
    first = max(start, int(np.searchsorted(clock, release_s - _MARGIN_S)))
    last_s = meeting.impact_s + _MOST_FALL_TIMES * meeting.fall_time_s
    if len(rest):
        last_s = min(last_s, clock[rest[0]] + _MARGIN_S)
    last = min(end, int(np.searchsorted(clock, last_s)))
    fall_gravity, fall_sd = gravity_of(clock, heights, fall, noise)
    flight_gravity, flight_sd = gravity_of(clock, heights, flight, noise)
    drop = Drop(
        first=first,
        seconds=seconds[first:last],
        heights_m=heights[first:last],
        release_s=float(seconds[index] + release_s),
        release_m=release_m,
        impact_s=float(seconds[index] + meeting.impact_s),
        contact_m=meeting.contact_m,
        impact_speed_m_s=meeting.fall_speed,
        flight_restitution=meeting.restitution,
        flight_restitution_sd=meeting.restitution_sd,
        gravity_m_s2=meeting.gravity,
        drag=1 - fall_gravity / flight_gravity,
        drag_sd=float(np.hypot(fall_sd, flight_sd)) / abs(flight_gravity),
        noise_m=noise,
        rest_m=level,
        rest_tolerance_m=tolerance,
    )
    return drop, end


def _level(heights: Array) -> tuple[float, float]:
    """Height [m] of a ball at rest and its standard error; NaN where there are no samples.

    The later half counts: the last bounces are too small to tell from rest.
    """
    late = heights[len(heights) // 2 :]
    if not len(late):
        return float("nan"), float("nan")
    return float(np.median(late)), 1.25 * float(np.std(late)) / np.sqrt(len(late))
