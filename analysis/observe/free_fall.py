"""Find drops in a recorded height: the fall, the first impact, the first flight, the rest.

Between impacts the height is a parabola of one curvature, -g. The fall before an impact and the
flight after it are fitted together; where the two meet is the impact, to a small fraction of a
sample, and the drop height follows from the speed there. Nothing is assumed of g, of the table's
height or of the release: at first the ball may be held, carried or already falling.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.errors import NotFoundError

Array = NDArray[np.float64]

_MIN_SAMPLES = 10
_MIN_DROP_M = 0.02
_SLOPE_WINDOW_S = 0.025
_REST_WINDOW_S = 0.15
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
    def fall_time_s(self) -> float:
        """Time of a fall from rest to the impact's speed [s]."""
        return self.impact_speed_m_s / self.gravity_m_s2

    @property
    def drop_height_m(self) -> float:
        """Height of a fall from rest to the impact's speed [m]."""
        return self.impact_speed_m_s**2 / (2 * self.gravity_m_s2)


@dataclass(frozen=True)
class _Meeting:
    """Where fall and flight meet, on a clock that is 0 at the impact's sample."""

    impact_s: float
    contact_m: float
    contact_sd_m: float
    fall_speed: float
    rebound_speed: float
    fall: tuple[float, float, float]  # of the fall's parabola, highest power first

    @property
    def gravity(self) -> float:
        return -2 * self.fall[0]


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
    if span < max(_MIN_DROP_M, 20 * noise):
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
    times = np.lib.stride_tricks.sliding_window_view(seconds, width + 1)
    values = np.lib.stride_tricks.sliding_window_view(heights, width + 1)
    times = times - times.mean(axis=1, keepdims=True)
    slopes = (times * values).sum(axis=1) / (times**2).sum(axis=1)
    before, after = slopes[:-width], slopes[width:]  # of sample i + width
    jump = np.where((before < 0) & (after > 0.5 * before), after - before, 0.0)
    peaks: list[int] = []
    for index in np.flatnonzero(jump > 0.35 * jump.max()):
        if peaks and index - peaks[-1] <= width:
            peaks[-1] = max(peaks[-1], int(index), key=lambda at: jump[at])
        else:
            peaks.append(int(index))
    return [peak + width for peak in peaks]


def _fit(
    seconds: Array, heights: Array, start: int, index: int, noise: float
) -> tuple[Drop, int]:
    """The drop that first hits the table near sample `index`, and the sample where it ends."""
    clock = seconds - seconds[index]
    fall, residual = _fall_samples(clock, heights, start, index, noise)
    parabola = np.polyfit(clock[fall], heights[fall], 2)
    flight = _flight_samples(clock, heights, index, parabola, noise)
    meeting = _meet(clock, heights, fall, flight, parabola, noise)
    depth = meeting.fall_speed**2 / (2 * meeting.gravity)
    rest, end = _rest_and_end(clock, heights, index, meeting.contact_m, depth, noise)
    level = float(np.median(heights[rest])) if len(rest) else float("nan")
    if len(rest):
        level_sd = 1.25 * noise / np.sqrt(len(rest))
        close = abs(level - meeting.contact_m) < 4 * meeting.contact_sd_m + 0.02 * depth
        if close and level_sd < meeting.contact_sd_m:
            meeting = _meet_at(level, clock, heights, flight, meeting)
    elif not len(flight):
        raise NotFoundError("the recording ends before the ball rebounds")
    _require_rebound(clock[:end] - meeting.impact_s, heights[:end], meeting, noise)
    apex_s, apex_m = _release(clock, heights, start, int(fall[-1]), meeting)
    first = max(start, int(np.searchsorted(clock, apex_s - _MARGIN_S)))
    last = min(end, int(np.searchsorted(clock, clock[rest[0]] + _MARGIN_S))) if len(rest) else end
    drop = Drop(
        first=first,
        seconds=seconds[first:last],
        heights_m=heights[first:last],
        release_s=float(seconds[index] + apex_s),
        release_m=apex_m,
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


def _fall_samples(
    clock: Array, heights: Array, start: int, index: int, noise: float
) -> tuple[NDArray[np.intp], float]:
    """Samples of the free fall before `index`, and their residual [m] about a parabola."""
    low = heights[index]
    top, first = low, index
    while first > start and heights[first - 1] > top - 6 * noise - 0.05 * (top - low):
        first -= 1
        top = max(top, heights[first])
    depth = top - low
    if depth < max(_MIN_DROP_M, 15 * noise):
        raise NotFoundError(f"the ball falls by only {1000 * depth:.0f} mm")
    for share in (0.95, 0.8, 0.6, 0.4, 0.25):
        high = np.flatnonzero(heights[first : index - 1] > low + share * depth)
        begin = first + (int(high[-1]) + 1 if len(high) else 0)
        samples = np.arange(begin, index - 1)
        if len(samples) < 5:
            continue
        parabola = np.polyfit(clock[samples], heights[samples], 2)
        off = heights[samples] - np.polyval(parabola, clock[samples])
        residual = float(np.sqrt(np.mean(off**2)))
        if parabola[0] < 0 and residual < 2 * noise + 0.002 * depth:
            return samples, residual
    raise NotFoundError("no free fall is seen before an impact (carried, or too few samples)")


def _flight_samples(
    clock: Array, heights: Array, index: int, fall: Array, noise: float
) -> NDArray[np.intp]:
    """Samples of the first flight: as long as they lie on one parabola of the fall's curvature."""
    straight = heights - fall[0] * clock**2
    tolerance = 4 * noise + 5e-4 * np.ptp(heights)
    lowest = float(heights[max(index - 3, 0) : index + 4].min())
    landing = _falling_to(lowest, fall, 0.0)
    doubt_s = (clock[index] - clock[index - 1]) / 2 + 3 * noise / max(landing.fall_speed, 1e-3)
    begin = int(np.searchsorted(clock, landing.impact_s + doubt_s))
    stop = begin + 3
    while stop <= len(heights):
        samples = np.arange(begin, stop)
        line = np.polyfit(clock[samples], straight[samples], 1)
        if np.abs(straight[samples] - np.polyval(line, clock[samples])).max() > tolerance:
            break
        stop += 1
    samples = np.arange(begin, stop - 2)  # the last one may have touched the table
    return samples if len(samples) >= 3 else samples[:0]


def _meet(
    clock: Array,
    heights: Array,
    fall: NDArray[np.intp],
    flight: NDArray[np.intp],
    parabola: Array,
    noise: float,
) -> _Meeting:
    """Fit fall and flight with one curvature, and find where they meet."""
    if not len(flight):
        lowest = int(fall[-1]) + 1 + int(np.argmin(heights[fall[-1] + 1 : fall[-1] + 5]))
        doubt = abs(heights[lowest] - heights[fall[-1]])
        return _falling_to(float(heights[lowest]), parabola, doubt)
    times = np.concatenate([clock[fall], clock[flight]])
    in_fall = np.arange(len(times)) < len(fall)
    design = np.column_stack([in_fall, in_fall * times, ~in_fall, ~in_fall * times, times**2])
    values = np.concatenate([heights[fall], heights[flight]])
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    covariance = max(noise, 1e-9) ** 2 * np.linalg.pinv(design.T @ design)

    def contact(coefficients: Array) -> float:
        a, b, c, d, e = coefficients
        at = (c - a) / (b - d)
        return a + b * at + e * at**2

    steps = np.sqrt(np.diag(covariance))
    slope = np.array(
        [(contact(solution + row) - contact(solution - row)) / 2 for row in np.diag(steps)]
    )
    correlation = covariance / np.outer(steps, steps)
    a, b, c, d, e = solution
    impact = (c - a) / (b - d)
    return _Meeting(
        impact_s=float(impact),
        contact_m=float(contact(solution)),
        contact_sd_m=float(np.sqrt(max(slope @ correlation @ slope, 0.0))),
        fall_speed=float(-(b + 2 * e * impact)),
        rebound_speed=float(d + 2 * e * impact),
        fall=(float(e), float(b), float(a)),
    )


def _falling_to(
    level: float, parabola: Array | tuple[float, float, float], level_sd: float
) -> _Meeting:
    """The meeting of a fall, h = p0 t^2 + p1 t + p2, with a known level."""
    curve, slope, offset = parabola
    speed = float(np.sqrt(max(slope**2 - 4 * curve * (offset - level), 0.0)))
    return _Meeting(
        impact_s=float((-slope - speed) / (2 * curve)),
        contact_m=level,
        contact_sd_m=level_sd,
        fall_speed=speed,
        rebound_speed=float("nan"),
        fall=(float(curve), float(slope), float(offset)),
    )


def _meet_at(
    level: float,
    clock: Array,
    heights: Array,
    flight: NDArray[np.intp],
    meeting: _Meeting,
) -> _Meeting:
    """The same meeting where the contact's height is known better from the ball at rest."""
    known = _falling_to(level, meeting.fall, 0.0)
    if not len(flight):
        return known
    since = clock[flight] - known.impact_s
    straight = heights[flight] - level + meeting.gravity / 2 * since**2
    return replace(known, rebound_speed=float(since @ straight / (since @ since)))


def _release(
    clock: Array, heights: Array, start: int, last: int, meeting: _Meeting
) -> tuple[float, float]:
    """When [s] and at what height [m] the fall began: the apex of its upper quarter.

    Drag bends a long fall, so the parabola of its end would put the release elsewhere.
    """
    curve, slope, offset = meeting.fall
    apex_s = -slope / (2 * curve)
    apex_m = offset - slope**2 / (4 * curve)
    top = heights[max(start, last - 5) : last + 1].max()
    begin = last
    while begin > start and heights[begin - 1] >= heights[begin] - 0.01 * (top - meeting.contact_m):
        begin -= 1
        top = max(top, heights[begin])
    share = (heights[begin : last + 1] - meeting.contact_m) / (top - meeting.contact_m)
    upper = begin + np.flatnonzero((share > 0.75) & (share < 0.985))
    if len(upper) >= 5:
        parabola = np.polyfit(clock[upper], heights[upper], 2)
        at = -parabola[1] / (2 * parabola[0])
        if parabola[0] < 0 and abs(at - apex_s) < 0.25 * (meeting.impact_s - apex_s):
            return float(at), float(np.polyval(parabola, at))
    return float(apex_s), float(apex_m)


def _rest_and_end(
    clock: Array, heights: Array, index: int, contact: float, depth: float, noise: float
) -> tuple[NDArray[np.intp], int]:
    """Samples at rest after the bounces (perhaps none), and where the ball is moved again."""
    after = heights[index + 1 :]
    above = np.flatnonzero(after > contact + 1.1 * depth + 6 * noise)
    end = index + 1 + (int(above[0]) if len(above) else len(after))
    width = int(np.ceil(_REST_WINDOW_S / float(np.median(np.diff(clock))))) + 1
    if end - index - 1 < width:
        return np.arange(0), end
    windows = np.lib.stride_tricks.sliding_window_view(heights[index + 1 : end], width)
    still = np.ptp(windows, axis=1) < 0.002 * depth + 8 * noise
    low = windows.max(axis=1) < contact + 0.05 * depth + 8 * noise
    settled = np.flatnonzero(still & low)
    if not len(settled):
        return np.arange(0), end
    begin = index + 1 + int(settled[0])
    level = np.median(heights[begin : begin + width])
    moved = np.flatnonzero(np.abs(heights[begin:end] - level) > 0.02 * depth + 8 * noise)
    end = begin + int(moved[0]) if len(moved) else end
    return np.arange(begin, end), end


def _require_rebound(since: Array, heights: Array, meeting: _Meeting, noise: float) -> None:
    """Raise unless the ball rises after the impact by more than chance would have it."""
    depth = meeting.fall_speed**2 / (2 * meeting.gravity)
    fall_time = meeting.fall_speed / meeting.gravity
    early = (since > 0) & (since < 0.25 * fall_time)
    if not early.any():
        raise NotFoundError("the recording ends before the ball rebounds")
    rise = float(np.mean(heights[early])) - meeting.contact_m
    hop = float(np.quantile(heights[(since > 0) & (since < 2 * fall_time)], 0.97)) - meeting.contact_m
    small = rise < 3 * noise / np.sqrt(early.sum()) + 1e-5 * depth
    if small and hop < 3 * noise + 1e-4 * depth:
        raise NotFoundError("the ball does not bounce: it stays where it lands")
