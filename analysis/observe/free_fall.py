"""Find drops in a recorded height: the fall, the first impact, the first flight, the rest.

Between impacts the height is a parabola of one curvature, -g. The fall before an impact and the
flight after it are fitted together; where the two meet is the impact, to a small fraction of a
sample, and the drop height follows from the speed there. Nothing is assumed of g, of the table's
height or of the release: at first the ball may be held, carried or already falling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.observe.impact import Meeting, falling_to, meet, meet_at
from analysis.observe.segments import (
    MIN_DROP_M,
    fall_samples,
    fit_parabola,
    flight_samples,
    rebounds,
    release,
    rest_and_end,
)
from tunenet_logs.errors import NotFoundError

Array = NDArray[np.float64]

_MIN_SAMPLES = 10
_SLOPE_WINDOW_S = 0.025
_MARGIN_S = 1.0


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
        rebound_speed_m_s: just after it; NaN where too little of the first flight is seen.
        gravity_m_s2: fitted acceleration.
        noise_m: standard deviation of the samples about a smooth curve [m].
        fall_residual_m: root mean square of the fall about its parabola [m].
        rest_m: height where the ball comes to rest [m]; NaN where it is not seen to.
    """

    first: int
    seconds: Array
    heights_m: Array
    release_s: float
    release_m: float
    impact_s: float
    contact_m: float
    impact_speed_m_s: float
    rebound_speed_m_s: float
    gravity_m_s2: float
    noise_m: float
    fall_residual_m: float
    rest_m: float

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
    noise = _noise(heights_m)
    span = float(np.ptp(heights_m))
    if span < max(MIN_DROP_M, 20 * noise):
        raise NotFoundError(f"the ball does not fall: it moves by {1000 * span:.1f} mm in all")
    drops: list[Drop] = []
    reasons: list[str] = []
    end = 0
    for index in _impact_candidates(seconds, heights_m):
        if index >= end:
            try:
                drop, end = _fit(seconds, heights_m, end, index, noise)
                drops.append(drop)
            except NotFoundError as reason:
                reasons.append(str(reason))
    if not drops:
        raise NotFoundError(reasons[0] if reasons else "no fall ends in an impact")
    return drops


def _noise(heights: Array) -> float:
    """Robust noise [m] from third differences, which a parabola does not have."""
    return float(np.median(np.abs(np.diff(heights, 3)))) / (0.6745 * np.sqrt(20.0))


def _impact_candidates(seconds: Array, heights: Array) -> list[int]:
    """Samples at which a fast fall ends within a sample or two, in order."""
    width = max(2, round(_SLOPE_WINDOW_S / float(np.median(np.diff(seconds)))))
    if len(heights) <= 2 * width:
        return []
    slopes = _slopes(seconds, heights, width)
    before, after = slopes[:-width], slopes[width:]  # of sample i + width
    fast = before < 0.3 * min(before.min(), 0.0)
    jump = np.where(fast & (after > 0.5 * before), after - before, 0.0)
    peaks: list[int] = []
    for index in np.flatnonzero(jump > 0.35 * max(jump.max(), 1e-9)):
        if peaks and index - peaks[-1] <= width:
            peaks[-1] = max(peaks[-1], int(index), key=lambda at: jump[at])
        else:
            peaks.append(int(index))
    return [peak + width for peak in peaks]


def _slopes(seconds: Array, heights: Array, width: int) -> Array:
    """Slope [m/s] of each run of width + 1 samples, between the means of its halves."""
    half = (width + 1) // 2

    def rise(values: Array) -> Array:
        sums = np.concatenate([[0.0], np.cumsum(values - values[0])])
        means = (sums[half:] - sums[:-half]) / half
        return means[width + 1 - half :] - means[: half - width - 1]

    return rise(heights) / rise(seconds)


def _fit(seconds: Array, heights: Array, start: int, index: int, noise: float) -> tuple[Drop, int]:
    """The drop that first hits the table near sample `index`, and the sample where it ends."""
    clock = seconds - seconds[index]
    fall, residual = fall_samples(clock, heights, start, index, noise)
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
    close = abs(level - meeting.contact_m) < _near_contact(meeting)
    if close and level_sd < meeting.contact_sd_m:
        meeting = meet_at(level, clock, heights, flight, meeting)
    if not rebounds(clock[:end] - meeting.impact_s, heights[:end], meeting, noise):
        raise NotFoundError("the ball does not bounce: it stays where it lands")
    release_s, release_m = release(clock, heights, start, int(fall[-1]), meeting)
    first = max(start, int(np.searchsorted(clock, release_s - _MARGIN_S)))
    last = min(end, int(np.searchsorted(clock, clock[rest[0]] + _MARGIN_S))) if len(rest) else end
    drop = Drop(
        first=first,
        seconds=seconds[first:last],
        heights_m=heights[first:last],
        release_s=float(seconds[index] + release_s),
        release_m=release_m,
        impact_s=float(seconds[index] + meeting.impact_s),
        contact_m=meeting.contact_m,
        impact_speed_m_s=meeting.fall_speed,
        rebound_speed_m_s=meeting.rebound_speed,
        gravity_m_s2=meeting.gravity,
        noise_m=noise,
        fall_residual_m=residual,
        rest_m=level,
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


def _near_contact(meeting: Meeting) -> float:
    """How far the level of rest may lie from the contact's to be the same table [m]."""
    return 4 * meeting.contact_sd_m + 0.02 * meeting.drop_height_m
