"""Drop detection in a recorded height: the fall, the first impact, the first flight, the rest.

Between impacts the height is a parabola of one curvature, -g. The fall before an impact and the
flight after it are fitted together; where the two meet is the impact, to a small fraction of a
sample, and the drop height follows from the speed there. Nothing is assumed of g, of the table's
height or of the release: at first the ball may be held, carried or already falling.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop import DENSER, GOOD_DROP, LONGER
from tunenet_logs.analysis.statistics import noise_of
from tunenet_logs.episode import Array, median_step
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# ---- Impact where a fall and the flight after it meet
# Throughout, `clock` are times [s] and `heights` heights [m], shape (T,), `noise` is the standard
# deviation of a height [m], and `index` a sample within one or two of the impact.

Indices = NDArray[np.intp]  # of samples, increasing


@dataclass(frozen=True, eq=False)
class Impact:
    """First impact of a drop."""

    impact_s: float  # its time [s]
    contact_m: float  # height at contact [m]
    impact_speed_m_s: float  # just before, positive
    # Ratio of the speeds after and before, by the parabolas of fall and flight alone; NaN where too
    # little of the first flight is seen.
    flight_restitution: float
    flight_restitution_sd: float  # its standard error; NaN likewise
    gravity_m_s2: float  # fitted acceleration of fall and flight together

    @property
    def fall_time_s(self) -> float:
        """Time of a fall from rest to the impact's speed [s]."""
        return self.impact_speed_m_s / self.gravity_m_s2

    @property
    def drop_height_m(self) -> float:
        """Height of a fall from rest to the impact's speed [m]."""
        return self.impact_speed_m_s**2 / (2 * self.gravity_m_s2)

    def after(self, start_s: float) -> dict[str, Any]:
        """Return the impact's own fields, on a clock on which its clock began at `start_s`."""
        own = {field.name: getattr(self, field.name) for field in fields(Impact)}
        return {**own, "impact_s": start_s + self.impact_s}


@dataclass(frozen=True, eq=False)
class ImpactFit(Impact):
    """Fitted impact, on a clock of the caller's."""

    contact_sd_m: float  # standard error of the contact's height [m]
    fall: Array  # parabola of the fall, highest power first, shape (3,)


def meet(clock: Array, heights: Array, fall: Indices, flight: Indices, noise: float) -> ImpactFit:
    """Locate an impact by intersecting the parabolas before and after it.

    One least-squares fit gives both, with one curvature. Standard errors are its covariance carried
    through the crossing by central differences (the delta method). Needs 2 samples of the flight.
    """
    times = np.concatenate([clock[fall], clock[flight]])
    in_fall = np.arange(len(times)) < len(fall)
    design = np.column_stack([in_fall, in_fall * times, ~in_fall, ~in_fall * times, times**2])
    values = np.concatenate([heights[fall], heights[flight]])
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    covariance = max(noise, 1e-9) ** 2 * np.linalg.pinv(design.T @ design)
    steps = np.sqrt(np.diag(covariance))
    nudges: Array = np.diag(steps)
    either_way = [_crossing(solution + step) - _crossing(solution - step) for step in nudges]
    slopes = np.array(either_way) / 2  # shape (5, 4)
    correlation = covariance / np.outer(steps, steps)
    errors = np.sqrt(np.maximum(np.diag(slopes.T @ correlation @ slopes), 0.0))
    impact_s, contact_m, speed_m_s, restitution = _crossing(solution).tolist()
    offset, slope, _, _, curve = solution.tolist()
    return ImpactFit(
        impact_s=impact_s,
        contact_m=contact_m,
        impact_speed_m_s=speed_m_s,
        flight_restitution=restitution,
        flight_restitution_sd=float(errors[3]),
        gravity_m_s2=-2 * curve,
        contact_sd_m=float(errors[1]),
        fall=np.array([curve, slope, offset]),
    )


def falling_to(level_m: float, fall: Array, level_sd_m: float = 0.0) -> ImpactFit:
    """Intersect a fall's parabola (highest power first) with a level [m]; the rebound is NaN."""
    curve, slope, offset = fall.tolist()
    speed = float(np.sqrt(max(slope**2 - 4 * curve * (offset - level_m), 0.0)))
    return ImpactFit(
        impact_s=(-slope - speed) / (2 * curve),
        contact_m=level_m,
        impact_speed_m_s=speed,
        flight_restitution=np.nan,
        flight_restitution_sd=np.nan,
        gravity_m_s2=-2 * curve,
        contact_sd_m=level_sd_m,
        fall=fall,
    )


def gravity_of(clock: Array, heights: Array, indices: Indices, noise: float) -> float:
    """Estimate the acceleration of free flight [m/s²]; NaN where the samples do not fix it."""
    if len(indices) < 4:
        return np.nan
    times = clock[indices] - clock[indices].mean()
    design = np.column_stack([np.ones_like(times), times, times**2])
    solution, *_ = np.linalg.lstsq(design, heights[indices], rcond=None)
    sd = 2 * noise * np.sqrt(max(np.linalg.pinv(design.T @ design)[2, 2], 0.0))
    return float(-2 * solution[2]) if sd < 0.5 else np.nan  # [m/s²], a twentieth of gravity


def _crossing(coefficients: NDArray[Any]) -> Array:
    """Return time, height, speed before and ratio of the speeds where two parabolas cross."""
    offset, slope, offset_up, slope_up, curve = coefficients
    impact = (offset_up - offset) / (slope - slope_up)
    speed = -(slope + 2 * curve * impact)
    after = slope_up + 2 * curve * impact
    height = offset + slope * impact + curve * impact**2
    return np.array([impact, height, speed, after / speed])


# ---- Samples of the fall, of the first flight and of the rest

MIN_DROP_M = 0.02  # a lower fall lasts 64 ms: a camera of 60 Hz sees it in four pictures
_REST_WINDOW_S = 0.25  # longer than the top of a bounce stays within the tolerance of a rest


def fall_samples(
    clock: Array, heights: Array, start: int, index: int, noise: float
) -> tuple[Indices, Array]:
    """Select the samples of the free fall before an impact, and fit their parabola, shape (3,).

    It is the largest lower part of the way down, 4 samples or more from `start` on, that is a
    parabola: the ball may have been held, carried or lowered by hand before.
    """
    low = float(heights[index])
    top, first = low, index
    while first > start and heights[first - 1] > top - 6 * noise - 0.05 * (top - low):
        first -= 1
        top = max(top, float(heights[first]))
    depth = top - low
    if depth < max(MIN_DROP_M, 15 * noise):
        raise NotFoundError(f"the ball falls by only {1000 * depth:.0f} mm", GOOD_DROP)
    for fraction in (0.95, 0.8, 0.6, 0.4, 0.25):  # the largest first
        high = np.flatnonzero(heights[first : index - 1] > low + fraction * depth)
        begin = first + (int(high[-1]) + 1 if len(high) else 0)
        fall = np.arange(begin, index - 1)
        if len(fall) < 4:  # one more than its parabola has coefficients
            continue
        parabola = np.polyfit(clock[fall], heights[fall], 2)
        residuals = heights[fall] - np.polyval(parabola, clock[fall])
        if parabola[0] < 0 and np.sqrt(np.mean(residuals**2)) < 2 * noise + 0.002 * depth:
            return fall, parabola
    what = "no free fall is seen before an impact (carried, or too few samples)"
    raise NotFoundError(what, GOOD_DROP)


def release(
    clock: Array, heights: Array, start: int, last: int, impact: ImpactFit
) -> tuple[float, float]:
    """Estimate when [s] and at what height [m] a fall began: the apex of its upper quarter.

    Drag bends a long fall, so the parabola of its end would put the release elsewhere.
    """
    contact = impact.contact_m
    begin, top = last, float(heights[max(start, last - 5) : last + 1].max())
    while begin > start and heights[begin - 1] >= heights[begin] - 0.01 * (top - contact):
        begin -= 1
        top = max(top, float(heights[begin]))
    fraction = (heights[begin : last + 1] - contact) / (top - contact)
    upper = begin + np.flatnonzero((fraction > 0.75) & (fraction < 0.985))
    parabolas = [impact.fall]
    if len(upper) >= 5:
        parabola = np.polyfit(clock[upper], heights[upper], 2)
        parabolas += [parabola] if parabola[0] < 0 else []
    apexes = [
        (-slope / (2 * curve), offset - slope**2 / (4 * curve))
        for curve, slope, offset in (parabola.tolist() for parabola in parabolas)
    ]
    apex_s = apexes[0][0]
    near = abs(apexes[-1][0] - apex_s) < 0.25 * (impact.impact_s - apex_s)
    return apexes[-1 if near else 0]


def flight_samples(clock: Array, heights: Array, index: int, fall: Array, noise: float) -> Indices:
    """Select the first flight's samples: those on one parabola, of about the fall's curvature.

    Their number, at least 3 or none, is found by doubling, then by bisection. `fall` is the fall's
    parabola, highest power first, shape (3,).
    """
    tolerance = 4 * noise + 5e-4 * np.ptp(heights)
    landing = falling_to(float(heights[max(index - 3, 0) : index + 4].min()), fall)
    speed_m_s = max(landing.impact_speed_m_s, 1e-3)
    doubt_s = (clock[index] - clock[index - 1]) / 2 + 3 * noise / speed_m_s  # of the landing
    begin = int(np.searchsorted(clock, landing.impact_s + doubt_s))

    def is_flight(stop: int) -> bool:
        if stop > len(clock):
            return False
        times = clock[begin:stop]
        curve = fall[0]
        if stop - begin > 6:  # the air slows a fall more than a flight
            free = float(np.polyfit(times - times.mean(), heights[begin:stop], 2)[0])
            curve = float(np.clip(free, 1.8 * fall[0], fall[0]))  # nor far more
        straight = heights[begin:stop] - curve * times**2
        off = straight - np.polyval(np.polyfit(times, straight, 1), times)
        return bool(np.abs(off).max() < tolerance)

    if not is_flight(begin + 3):
        return np.arange(0)
    reach = 3
    while is_flight(begin + 2 * reach):
        reach *= 2
    good, bad = begin + reach, begin + 2 * reach
    while bad - good > 1:
        middle = (good + bad) // 2
        good, bad = (middle, bad) if is_flight(middle) else (good, middle)
    samples = np.arange(begin, good - 1)  # the last one may have touched the table
    return samples if len(samples) >= 3 else samples[:0]


def rest_and_end(
    clock: Array, heights: Array, index: int, impact: Impact, noise: float
) -> tuple[Indices, int]:
    """Find the samples at rest after the bounces (perhaps none), and where the ball is moved."""
    contact, depth = impact.contact_m, impact.drop_height_m
    after = heights[index + 1 :]
    above = np.flatnonzero(after > contact + 1.1 * depth + 6 * noise)
    end = index + 1 + (int(above[0]) if len(above) else len(after))
    width = int(np.ceil(_REST_WINDOW_S / median_step(clock))) + 1
    third = width // 3
    sag = impact.gravity_m_s2 * (_REST_WINDOW_S / 3) ** 2
    begin, size = index + 1, 256  # a ball rests soon, whatever the recording's length
    while third and end - begin >= width:
        block = heights[begin : min(begin + size + width - 1, end)]
        windows = np.lib.stride_tricks.sliding_window_view(block, width)
        highest, lowest = windows.max(axis=1), windows.min(axis=1)
        # Near the top of a bounce a ball hardly moves either, but it curves.
        edges = windows[:, :third].mean(axis=1) + windows[:, -third:].mean(axis=1)
        bend = edges - 2 * windows[:, third : width - third].mean(axis=1)
        still = (highest - lowest < 0.002 * depth + 8 * noise) & (np.abs(bend) < sag / 2)
        low = highest < contact + 0.05 * depth + 8 * noise
        settled = np.flatnonzero(still & low)
        if len(settled):
            begin += int(settled[0])
            break
        begin, size = begin + size, 2 * size
    else:
        return np.arange(0), end
    level = np.median(heights[begin : begin + width])
    moved = np.flatnonzero(np.abs(heights[begin:end] - level) > 0.02 * depth + 8 * noise)
    end = begin + int(moved[0]) if len(moved) else end
    return np.arange(begin, end), end


# ---- All drops of a recording, from corners of its slope

_MIN_SAMPLES = 10  # for a fall and a flight (5 and 3 samples), and for a noise
_MARGIN_S = 1.0  # kept before the release and of the rest, to be seen in a review


@dataclass(frozen=True, eq=False, kw_only=True)
class Drop(Impact):
    """One drop: its first impact, and the samples around it."""

    first: int  # index of its first sample in the recording: a second before the release
    seconds: Array  # times of its samples [s], shape (T,); until the ball rests or is lifted again
    heights_m: Array  # heights there [m], shape (T,)
    release_s: float  # when the ball was let go, or would have been for this fall [s]
    release_m: float  # height there [m]
    # Fitted acceleration of the first flight alone, in which the air adds to gravity on the way up
    # as much as it takes from it on the way down; NaN where too little of it is seen.
    flight_gravity_m_s2: float = np.nan
    # Times of the first and the last sample of the fall that is a parabola [s].
    fall_s: tuple[float, float]
    # The same of the first flight; twice the impact's where too little is seen.
    flight_s: tuple[float, float]
    noise_m: float  # standard deviation of the samples about a smooth curve [m]
    rest_s: float = np.nan  # when the ball begins to rest [s]; NaN where it is not seen to
    rest_m: float = np.nan  # height there [m]; NaN likewise
    rest_tolerance_m: float = 0.0  # how far from the contact that may be on one table [m]
    # Whether the ball already flew at the first sample: it was thrown, or bounced before. Its
    # release is then that sample.
    launched: bool = False
    is_free: bool = True  # whether fall or flight have about the gravity of the earth
    scale_known: bool = True  # whether the heights are in true metres
    touching: int = 0  # how many samples were left out because the ball was on the ground in them

    @property
    def table_m(self) -> float:
        """Height of the ball on the table [m]: at rest where that is seen, else at contact.

        In a simulator with large steps a ball hits well below that.
        """
        return self.contact_m if np.isnan(self.rest_m) else self.rest_m


def find_drops(seconds: Array, heights_m: Array) -> list[Drop]:
    """Find all drops in heights [m] at times [s]; each ends where the ball is lifted again.

    Raises `NotFoundError` with the reason where there is none.
    """
    if len(seconds) < _MIN_SAMPLES:
        raise NotFoundError(f"{len(seconds)} samples of the ball are too few for a drop", DENSER)
    noise = noise_of(heights_m)
    span = float(np.ptp(heights_m))
    if span < max(MIN_DROP_M, 20 * noise):
        moved = f"the ball does not fall: it moves by {1000 * span:.1f} mm in all"
        raise NotFoundError(moved, GOOD_DROP)
    # In 25 ms a ball gains .25 m/s, little beside an impact's jump.
    width = max(2, round(0.025 / median_step(seconds)))
    impacts: list[int] = []
    if len(heights_m) > 2 * width:
        slopes = run_slopes(seconds, heights_m, width)
        # Of the fastest fall, before an impact; of the sharpest corner, at it.
        impacts = slope_corners(slopes, width, 0.12 * min(slopes[:-width].min(), 0.0), 0.15)
    drops: list[Drop] = []
    odd: list[Drop] = []
    reasons: list[NotFoundError] = []
    end = 0
    for index in impacts:
        if index < end:
            continue
        try:
            drop, drop_end = _fit_drop(seconds, heights_m, end, index, noise)
        except NotFoundError as reason:
            reasons.append(reason)
            continue
        later = [at for at in impacts if seconds[at] > drop.impact_s + drop.fall_time_s / 4]
        # Whether fall or flight, until the next fall ends, has about the gravity of the earth.
        next_s = float(seconds[later[0]]) if later else drop.impact_s
        inner = np.flatnonzero((drop.seconds > drop.impact_s) & (drop.seconds < next_s))[1:-1]
        between = gravity_of(drop.seconds, drop.heights_m, inner, drop.noise_m)
        seen = (drop.gravity_m_s2, drop.flight_gravity_m_s2, between)
        # A fifth off standard gravity any other drop of the recording is preferred.
        if any(abs(one / GRAVITY_M_S2 - 1) < 0.2 for one in seen):
            drops.append(drop)
            end = drop_end
        else:  # a hand may lower a ball along a parabola too
            odd.append(replace(drop, is_free=False))
    if not drops and not odd:
        raise reasons[0] if reasons else NotFoundError("no fall ends in an impact", GOOD_DROP)
    return drops or odd[:1]


def outliers(seconds: Array, heights_m: Array) -> NDArray[np.bool_]:
    """Flag single samples that no ball can have been at: marker swaps, dropped detections.

    Such a sample leaves both neighbours farther than a fall through the whole height could. That
    height is measured without the 4 highest and lowest samples, or a few outliers would hide
    themselves.
    """
    found = np.zeros(len(heights_m), dtype=bool)
    most = 8  # more of them are no exception: then it is the recording that is in doubt
    each_end = most // 2
    if len(heights_m) < 4 * each_end:
        return found
    ordered = np.partition(heights_m, (each_end, len(heights_m) - 1 - each_end))
    whole_m = ordered[-1 - each_end] - ordered[each_end]
    reach_m = np.sqrt(2 * GRAVITY_M_S2 * whole_m) * (seconds[2:] - seconds[:-2])
    off_m = np.abs(heights_m[1:-1] - (heights_m[2:] + heights_m[:-2]) / 2)
    apart_m = np.abs(heights_m[2:] - heights_m[:-2])
    found[1:-1] = (off_m > reach_m + 0.05 * whole_m) & (apart_m < off_m)
    return found if found.sum() <= most else np.zeros_like(found)


def run_slopes(seconds: Array, heights: Array, width: int) -> Array:
    """Return each slope a second over width + 1 samples, by the means of halves, (T - width,)."""
    half = (width + 1) // 2
    values = np.stack([heights, seconds])
    sums = np.cumsum(values - values[:, :1], axis=1)
    sums = np.concatenate([np.zeros((2, 1)), sums], axis=1)
    means = (sums[:, half:] - sums[:, :-half]) / half
    rise, time = means[:, width + 1 - half :] - means[:, : half - width - 1]
    return rise / time


def slope_corners(slopes: Array, width: int, fast: float, sharp: float) -> list[int]:
    """Locate the samples at which a fall with a slope below `fast` ends within a sample or two.

    Of corners nearer than `width` (see `run_slopes`) one counts; `sharp` is a fraction of the
    largest.
    """
    before, after = slopes[:-width], slopes[width:]  # of sample i + width
    change = np.where((before < fast) & (after > 0.5 * before), after - before, 0.0)
    corners: list[int] = []
    for index in np.flatnonzero(change > sharp * max(change.max(), 1e-9)):
        if corners and index - corners[-1] <= width:
            corners[-1] = max(corners[-1], int(index), key=lambda at: change[at])
        else:
            corners.append(int(index))
    return [corner + width for corner in corners]


def _fit_drop(
    seconds: Array, heights: Array, start: int, index: int, noise: float
) -> tuple[Drop, int]:
    """Fit the drop that first hits the table near sample `index`; return it and its end."""
    clock = seconds - seconds[index]
    # Most of a log may be rest, and quieter.
    before = heights[max(start, int(np.searchsorted(clock, -0.4))) : index]
    noise = max(noise, noise_of(before)) if len(before) >= _MIN_SAMPLES else noise
    fall, parabola = fall_samples(clock, heights, start, index, noise)
    flight = flight_samples(clock, heights, index, parabola, noise)
    if len(flight):
        impact = meet(clock, heights, fall, flight, noise)
        # A short or bent flight may be .05 off.
        if impact.flight_restitution < -0.05 - 3 * impact.flight_restitution_sd:
            raise NotFoundError("the ball falls on: it hits nothing there", GOOD_DROP)
    else:
        near = heights[index - 1 : index + 4]
        impact = falling_to(float(near.min()), parabola, level_sd_m=float(np.ptp(near)))
    rest, end = rest_and_end(clock, heights, index, impact, noise)
    if not len(rest) and not len(flight):
        raise NotFoundError("the recording ends before the ball rebounds", LONGER)
    level_m = np.nan
    tolerance_m = 4 * impact.contact_sd_m + 0.001 * impact.drop_height_m + 0.001
    if len(rest):
        late = heights[rest[len(rest) // 2 :]]  # the last bounces are too small to tell from rest
        level_m = float(np.median(late))
        level_sd_m = 1.25 * float(np.std(late)) / np.sqrt(len(late))  # of a median
        same_table = abs(level_m - impact.contact_m) < tolerance_m
        if same_table and level_sd_m < impact.contact_sd_m:
            # The restitution stays that of the parabolas: a cross-check must not lean on the rest.
            impact = replace(
                falling_to(level_m, impact.fall),
                flight_restitution=impact.flight_restitution,
                flight_restitution_sd=impact.flight_restitution_sd,
            )
    if not _has_rebound(clock[:end] - impact.impact_s, heights[:end], impact, noise):
        raise NotFoundError("the ball does not bounce: it stays where it lands", GOOD_DROP)
    release_s, release_m = release(clock, heights, start, int(fall[-1]), impact)
    first = max(start, int(np.searchsorted(clock, release_s - _MARGIN_S)))
    last_s = impact.impact_s + 40 * impact.fall_time_s  # a ball of restitution .95 lies still
    if len(rest):
        last_s = min(last_s, clock[rest[0]] + _MARGIN_S)
    last = min(end, int(np.searchsorted(clock, last_s)))
    ends = [seconds[index] + impact.impact_s] * 2 if not len(flight) else seconds[flight[[0, -1]]]
    drop = Drop(
        first=first,
        seconds=seconds[first:last],
        heights_m=heights[first:last],
        release_s=float(seconds[index] + release_s),
        release_m=release_m,
        **impact.after(float(seconds[index])),
        flight_gravity_m_s2=gravity_of(clock, heights, flight, noise),
        fall_s=(float(seconds[fall[0]]), float(seconds[fall[-1]])),
        flight_s=(float(ends[0]), float(ends[1])),
        noise_m=noise,
        rest_s=float(seconds[rest[0]]) if len(rest) else np.nan,
        rest_m=level_m,
        rest_tolerance_m=tolerance_m,
    )
    return drop, end


def _has_rebound(since: Array, heights: Array, impact: Impact, noise: float) -> bool:
    """Return whether the ball rises after the impact by more than chance would have it."""
    contact, depth = impact.contact_m, impact.drop_height_m
    early = (since > 0) & (since < 0.25 * impact.fall_time_s)
    if not early.any():
        raise NotFoundError("the recording ends before the ball rebounds", LONGER)
    rise = float(np.mean(heights[early])) - contact
    if rise > 3 * noise / np.sqrt(early.sum()) + 1e-5 * depth:
        return True
    later = (since > 0) & (since < 2 * impact.fall_time_s)
    return float(np.quantile(heights[later], 0.97)) - contact > 3 * noise + 1e-4 * depth
