"""Find a drop in a recorded track: which way is up, in which units, let go or thrown.

Gravity is what free flights share; by it a track is scaled to metres and seconds. Where the drop
found does not move as a ball, it is sought again without samples that are no places of the ball.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop import GOOD_DROP, LET_GO, RIGHT_LENGTHS
from tunenet_logs.analysis.drop.detection import DropDetection
from tunenet_logs.analysis.drop.film import film_impacts
from tunenet_logs.analysis.drop.free_flight import Drop, find_drops, outliers
from tunenet_logs.analysis.drop.launched import FlownHeights
from tunenet_logs.analysis.drop.motion import fit_excess_percent
from tunenet_logs.analysis.record import Units
from tunenet_logs.analysis.statistics import noise_of
from tunenet_logs.episode import FRAME_NS, UNSTATED, Array, Episode, Signal, median_step
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.ball import TOPIC
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.recorders.simulators.known import Ball

# ---- Gravity in a recording of any units: the acceleration that free flights share
# A body that nothing touches moves on a parabola, and all parabolas of one recording have the same
# acceleration; its direction says what is down. A hand, a rest or a slope shares it with nothing.

_MAX_SHARED = 1500  # windows that are compared, each with each


@dataclass(frozen=True, eq=False)
class Gravity:
    """Acceleration that the free flights of a recording share."""

    size: float  # in the recording's units
    up: Array  # unit vector against it, shape (3,)
    noise: float  # standard deviation of a position, by the flights' own residuals

    @property
    def up_name(self) -> str:
        """Axis nearest to up, by name: "+y"."""
        axis = int(np.abs(self.up).argmax())
        return ("+" if self.up[axis] > 0 else "-") + "xyz"[axis]


def gravity_in(seconds: Array, positions: Array, expected: float | None = None) -> Gravity | None:
    """Estimate the acceleration that free flights of positions, (T, 3), share; None without any.

    Where the units are known, only what is near the `expected` one counts.
    """
    noises = np.array([noise_of(axis) if len(axis) > 4 else 0.0 for axis in positions.T])
    sure = 8.0 if expected is None else 4.0  # standard errors that one is away from none
    # From a tenth of a second at 60 Hz to one at 1 kHz.
    found = [
        _accelerations(seconds, positions, noises, width, sure)
        for width in (7, 11, 17, 27, 43, 69, 109)
    ]
    vectors, offs, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    if expected is not None:
        near = np.abs(np.linalg.norm(vectors, axis=1) / expected - 1) < 0.2
        vectors, offs, weights = vectors[near], offs[near], weights[near]
    if len(vectors) > _MAX_SHARED:
        best = np.argsort(weights, kind="stable")[-_MAX_SHARED:]
        vectors, offs, weights = vectors[best], offs[best], weights[best]
    if not len(vectors):
        return None
    sizes = np.linalg.norm(vectors, axis=1)
    apart = np.linalg.norm(vectors[:, None] - vectors, axis=2)
    # The air, and noise, move an acceleration of free flight.
    alike = apart < 0.1 * np.minimum(sizes[:, None], sizes)
    most = int((alike @ weights).argmax())
    members = alike[most]
    if weights[members].sum() < (20 if expected is None else 6):  # windows that share it
        return None
    mean = np.average(vectors[members], axis=0, weights=weights[members])
    up = -mean / np.linalg.norm(mean)
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > np.cos(np.radians(3.0)):  # so near to the vertical it is the vertical
        up = np.sign(up[axis]) * np.eye(3)[axis]
    moving = np.count_nonzero(noises > 1e-3 * noises.max())  # one with less noise was not measured
    noise = float(np.median(offs[members]) / np.sqrt(max(moving, 1)))
    return Gravity(float(-mean @ up), up, noise)


def _accelerations(
    seconds: Array, positions: Array, noises: Array, width: int, sure: float
) -> tuple[Array, Array, Array]:
    """Return accelerations, residuals and weights of a width's parabolic windows, (W, ...)."""
    none = np.empty((0, 3)), np.empty(0), np.empty(0)
    if len(seconds) < width:
        return none
    every = max(1, width // 6, len(seconds) // 20_000)
    begins = np.arange(0, len(seconds) - width + 1, every)
    usual = median_step(seconds)
    parts = [none]
    for at in range(0, len(begins), 2000):  # a log of an hour has tens of thousands
        rows = begins[at : at + 2000, None] + np.arange(width)
        whole = np.ptp(seconds[rows], axis=1) < 2.0 * usual * width
        if whole.any():
            rows = rows[whole]
            vectors, off, kept = _parabolas(seconds[rows], positions[rows], noises, sure)
            parts.append((vectors[kept], off[kept], np.full(np.count_nonzero(kept), float(every))))
    vectors, off, weights = (np.concatenate(column) for column in zip(*parts, strict=True))
    return vectors, off, weights


def _parabolas(
    clock: Array, values: Array, noises: Array, sure: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fit W windows: accelerations, (W, 3), residuals, (W,), and which of them are sure, (W,)."""
    lasts, width = np.ptp(clock, axis=1), clock.shape[1]
    clock = 2 * (clock - clock.mean(axis=1, keepdims=True)) / lasts[:, None]
    design = np.stack([np.ones_like(clock), clock, clock**2], axis=2)
    normal = np.einsum("wti,wtj->wij", design, design)
    solution = np.linalg.solve(normal, np.einsum("wti,wtk->wik", design, values))
    off = values - np.einsum("wti,wik->wtk", design, solution)
    off = np.linalg.norm(np.sqrt(np.mean(off**2, axis=1) * width / (width - 3)), axis=1)
    curve = solution[:, 2]
    size = np.linalg.norm(curve, axis=1)
    noise = float(np.linalg.norm(noises))
    error = np.sqrt(np.linalg.inv(normal)[:, 2, 2]) * np.maximum(off, 0.5 * noise)
    kept = (size > sure * error) & (off < 3.0 * noise + 2e-3 * size)
    return 8 * curve / lasts[:, None] ** 2, off, kept


# ---- Height in which no drop was found, and what in it looks like an impact

_FARTHEST = 1e6  # a coordinate beyond it is a marker for "none"


@dataclass(frozen=True, eq=False)
class RecordedHeight:
    """Height of a position signal."""

    signal: Signal  # that it is of
    seconds: Array  # since the signal's first sample, rising, shape (T,)
    heights: Array  # over the lowest one, in the signal's unit, shape (T,)
    impacts: tuple[int, ...]  # samples at which a fast fall ends
    # Whether something falls freely in it, which tells what is up; else the axis along which it
    # moves most is drawn.
    is_free: bool


def position_signals(signals: Iterable[Signal]) -> list[Signal]:
    """Select the signals of positions, in the order in which a drop is sought in them."""
    positions = [one for one in signals if one.is_position]
    return sorted(positions, key=lambda one: (one.name != TOPIC, "ball" not in one.name, one.name))


def recorded_heights(episode: Episode, most: int) -> list[RecordedHeight]:
    """Return the heights of the first `most` signals of positions that have two samples."""
    found: list[RecordedHeight] = []
    for signal in position_signals(episode.signals.values())[:most]:
        keep = np.all(np.abs(signal.values) < _FARTHEST, axis=1)  # NaN is not
        seconds, values = signal.seconds[keep], signal.values[keep]
        if len(seconds) < 2:
            continue
        rising = np.concatenate([[True], seconds[1:] > np.maximum.accumulate(seconds)[:-1]])
        every = max(1, -(-np.count_nonzero(rising) // 20_000))  # more are looked through in steps
        seconds, values = seconds[rising][::every], values[rising][::every]
        is_long = len(seconds) >= 12  # else no impact is told
        gravity = gravity_in(seconds, values) if is_long else None
        heights = values @ (_likely_up(values) if gravity is None else gravity.up)
        heights = heights - heights.min()
        impacts: list[int] = []
        if is_long and heights.max() > 0:
            noise = max(noise_of(heights), 1e-4 * float(heights.max()))  # a simulator's have none
            impacts = film_impacts(seconds, heights, noise)
        found.append(RecordedHeight(signal, seconds, heights, tuple(impacts), gravity is not None))
    return found


def _likely_up(values: Array) -> Array:
    """Return the axis along which positions move most; z, if in doubt."""
    return np.eye(3)[int((np.ptp(values, axis=0) * np.array([0.5, 0.75, 1.0])).argmax())]


# ---- Outliers of a track: jumps to another thing, repeated pictures

_MIN_TRACK_SAMPLES = 15  # samples of a track in which something may be left out


@dataclass(frozen=True, eq=False)
class BallAlone:
    """Track without samples that are no places of the ball."""

    signal: Signal  # what is left
    jumps_ns: NDArray[np.int64]  # stamps of the jumps left out, shape (J,)
    words: tuple[str, ...]  # what was left out, for the user


def ball_alone(signal: Signal) -> BallAlone | None:
    """Remove jumps and, where no metres are named, repeats; None where nothing is left out."""
    steady = without_jumps(signal) or signal
    once = (None if signal.unit == "m" else without_repeats(steady)) or steady
    jumps_ns = np.setdiff1d(signal.stamps_ns, steady.stamps_ns)
    jumps, repeats = len(jumps_ns), len(steady.values) - len(once.values)
    words: list[str] = []
    if jumps:
        words.append(f"{jumps} samples of {signal.name} jump away and back: they were left out")
    if repeats:
        words.append(f"{repeats} pictures are there twice in {signal.name}: one was left out")
    return BallAlone(once, jumps_ns, tuple(words)) if words else None


def without_jumps(signal: Signal) -> Signal | None:
    """Remove samples that are far from both neighbours; None where none are, or too many.

    A tracker that takes another thing for the ball jumps there, stays for a few samples, and jumps
    back to near where the ball was.
    """
    values, count = signal.values, len(signal.values)
    if count < _MIN_TRACK_SAMPLES:
        return None
    low, high = np.quantile(values, (0.02, 0.98), axis=0)
    # A jump is 3 median steps and a tenth of the track long; its way back ends near its beginning.
    least = 0.1 * float(np.linalg.norm(high - low))
    steps = np.diff(values, axis=0)
    sizes = np.linalg.norm(steps, axis=1)
    # The median of the nine steps before and behind each, itself among them; shape (T - 1,).
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(sizes, 9, mode="reflect"), 2 * 9 + 1)
    far = np.flatnonzero((sizes > least) & (sizes > 3.0 * np.median(windows, axis=1)))
    left = np.zeros(count, bool)
    at = 0
    while at < len(far) - 1:
        away = far[at]
        for back in far[at + 1 : at + 1 + 8]:
            if back - away > 8:  # samples that a tracker stays with another thing
                break
            missed = float(np.linalg.norm(values[back + 1] - values[away]))
            if missed < 0.6 * min(sizes[away], sizes[back]):
                left[away + 1 : back + 1] = True
                at = int(np.searchsorted(far, back))
                break
        at += 1
    return _kept(signal, ~left) if 0 < left.sum() <= 0.2 * count else None


def without_repeats(signal: Signal) -> Signal | None:
    """Remove samples that are exactly where the one before is while the track moves.

    A film that is played at another rate holds pictures twice. None where no sample is like that.
    """
    if len(signal.values) < _MIN_TRACK_SAMPLES:
        return None
    low, high = np.quantile(signal.values, (0.02, 0.98), axis=0)
    sizes = np.linalg.norm(np.diff(signal.values, axis=0), axis=1)
    moving = sizes > 0.02 * float(np.linalg.norm(high - low))
    left = np.zeros((2, len(signal.values)), bool)
    beside = moving[:-2] & moving[2:]
    left[0, 2:-1] = (sizes[1:-1] == 0) & beside
    # A tracker sees the same picture's ball so near to itself.
    left[1, 2:-1] = (sizes[1:-1] <= 0.1 * np.minimum(sizes[:-2], sizes[2:])) & beside
    if not left[0].any():
        return None
    return _even(signal, left[1]) or _kept(signal, ~left[0])


def _even(signal: Signal, repeated: NDArray[np.bool_]) -> Signal | None:
    """Retime a film that holds every so many pictures twice; None if it does not.

    What holds 4 pictures in 5 stamps has taken them in 5/4 of a stamp's distance. That also finds
    the other repeated pictures, which a tracker saw at two places or at rest.
    """
    stamps = signal.stamps_ns - signal.stamps_ns[0]
    step_ns = median_step(stamps)
    numbers = np.round(stamps / step_ns).astype(np.int64)
    seen = numbers[repeated]
    gaps = np.diff(seen)
    is_film = np.abs(stamps - numbers * step_ns).max() < 0.1 * step_ns
    is_film &= bool(np.diff(numbers).min() > 0 and numbers[-1] < 4 * len(numbers))
    if len(gaps) < 3 or not is_film:
        return None
    # From one to the next there are three to twelve stamps.
    fits = {every: np.count_nonzero(gaps % every == 0) for every in range(3, 12 + 1)}
    every = max(fits, key=lambda one: (fits[one], one))
    if fits[every] < 0.6 * len(gaps):
        return None
    regular = np.concatenate([[False], gaps % every == 0, [False]])
    seen = seen[regular[1:] | regular[:-1]]
    gaps = np.diff(seen)
    parts = [np.arange(seen[0], -every, -every)[::-1]]
    for first, gap in zip(seen[:-1], gaps, strict=True):
        count = max(1, round(gap / every))
        parts.append(np.round(first + gap * np.arange(1, count + 1) / count).astype(np.int64))
    parts.append(np.arange(seen[-1] + every, numbers[-1] + 2 * every, every))
    twice = np.concatenate(parts)
    keep = ~np.isin(numbers, twice)
    pictures = numbers - np.searchsorted(twice, numbers, side="right")
    of_twice = twice - 1 - np.arange(len(twice))
    even = np.interp(pictures[keep], of_twice, twice - 1.0) * step_ns
    evenly_ns = signal.stamps_ns[0] + np.round(even).astype(np.int64)
    if np.any(np.diff(evenly_ns) <= 0):
        return None
    return replace(signal, stamps_ns=evenly_ns, values=signal.values[keep])


def _kept(signal: Signal, keep: NDArray[np.bool_]) -> Signal:
    return replace(signal, stamps_ns=signal.stamps_ns[keep], values=signal.values[keep])


# ---- Units of a track: named, inferred from gravity, or not to be determined
# Restitution needs no unit and no clock: a bounce is one curve in drop heights and fall times. What
# falls with 9,810 is in mm, with 981 in cm, with 386 in inches; else it is scaled, or its clock is.

# Units of length, and their metres, the likeliest first.
_UNITS = (("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("ft", 0.3048), ("in", 0.0254))
# Units in which times may be that were taken as seconds.
_CLOCKS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9), ("min", 60.0))
_MAX_UNIT_ERROR = 0.12  # fraction that a fall may be off gravity: the air


def units_words(units: Units) -> str:
    """Describe the units that were inferred, for a user; "" where all was named."""
    if units.doubt:
        return ""
    parts: list[str] = []
    if units.length_by == "gravity":
        unit = next((name for name, size in _UNITS if size == units.length_m), "")
        parts.append(f"lengths name no unit; by the fall they are in {unit}")
    elif units.length_by is None:
        parts.append("the unit of length is not known, so heights and speeds are not given")
    if units.rate_by == "gravity":
        parts.append(f"no rate is named; by the fall it is {units.rate_hz:.4g} frames a second")
    elif units.rate_by is None:
        parts.append("the frame rate is not known (see --fps)")
    return "; ".join(parts)


def named_units(signal: Signal) -> Units:
    """Return the units of a signal in metres, by its own clock."""
    by = "named" if signal.unit == "m" else "gravity"
    return Units(1.0, by, signal.rate_hz, "clock")


@dataclass(frozen=True, eq=False)
class Scaled:
    """Track in metres and seconds, as far as these can be known."""

    signal: Signal  # its values in m, its stamps in ns from the same first stamp
    size: float  # its metres in one unit of the log
    units: Units  # what is known of the log's


def scaled_by_gravity(signal: Signal, gravity: Gravity, height: float) -> Scaled:
    """Scale a track to units in which it falls with the gravity of the earth.

    `gravity`, and the `height` of its first drop, are in its own units and the seconds of its
    stamps.
    """
    ratio = GRAVITY_M_S2 / gravity.size  # metres in a unit, where the seconds are true
    near = next((one for one in _UNITS if abs(one[1] / ratio - 1) < _MAX_UNIT_ERROR), None)
    if signal.counts_frames:
        # Infer the rate of a track that counts frames, 1e9 / FRAME_NS of them a second.
        if signal.unit == "m":
            stretch = float(np.sqrt(1 / ratio))  # true seconds in one of the stamps
            rate_hz = 1e9 / FRAME_NS / stretch
            if 5.0 < rate_hz < 50_000.0:  # else it is a wrong unit's
                units = Units(1.0, "named", rate_hz, "gravity")
                return _scaled(signal, 1.0, stretch, units)
        size = 1.0 / height
        stretch = float(np.sqrt(size / ratio))
        return _scaled(signal, size, stretch, Units(None, None, None, None))
    rate_hz, is_metres = signal.rate_hz, signal.unit == "m"
    falls = f"falls with {GRAVITY_M_S2 / ratio:.4g} m/s²"
    if near is not None and (is_metres or signal.unit == UNSTATED):
        name, size = near
        units = Units(size, "gravity", rate_hz, "clock")
        if is_metres and size == 1.0:
            units = replace(units, length_by="named")
        elif is_metres:
            doubt = f"{falls}: the lengths are in {name}, it seems"
            units = replace(units, doubt=doubt, remedy=f"say --length-unit {name}")
        return _scaled(signal, size, 1.0, units)
    for name, size in _CLOCKS if is_metres or signal.unit == UNSTATED else ():
        if abs(size**2 * ratio - 1) < 2 * _MAX_UNIT_ERROR:
            units = Units(1.0, "gravity", rate_hz / size, "gravity")
            if is_metres:
                doubt = f"{falls}: the stamps are in {name}, it seems, not in s"
                remedy = "record true times"
                units = replace(units, length_by="named", doubt=doubt, remedy=remedy)
            return _scaled(signal, 1.0, size, units)
    alone = scaled_alone(signal, gravity)
    if not is_metres:
        return alone
    doubt = f"{falls}: lengths are in pixels or scaled, or the clock is wrong"
    remedy = "record lengths in m and the true times"
    return replace(alone, units=replace(alone.units, doubt=doubt, remedy=remedy))


def scaled_alone(signal: Signal, gravity: Gravity) -> Scaled:
    """Scale a track whose unit cannot be determined, by its own clock: of pixels, or of a scale."""
    ratio = GRAVITY_M_S2 / gravity.size
    return _scaled(signal, ratio, 1.0, Units(None, None, signal.rate_hz, "clock"))


def _scaled(signal: Signal, size: float, stretch: float, units: Units) -> Scaled:
    """Multiply values by `size`, and times since the first stamp by `stretch`."""
    stamps_ns = signal.stamps_ns
    if stretch != 1.0 and len(stamps_ns):
        since: Array = (stamps_ns - stamps_ns[0]).astype(np.float64) * stretch
        stamps_ns = stamps_ns[0] + np.round(since).astype(np.int64)
    scaled = replace(signal, stamps_ns=stamps_ns, values=signal.values * size, unit="m")
    return Scaled(scaled, size, units)


# ---- Detection of the drop in one track

# What may be up, the likeliest first.
_AXES = {
    f"{'+' if sign > 0 else '-'}{'xyz'[axis]}": sign * np.eye(3)[axis]
    for axis in (2, 1, 0)
    for sign in (1, -1)
}
_WITHIN_GRAVITY = 0.05  # a drop that falls farther off gravity is looked at again


@dataclass(frozen=True, eq=False)
class PositionTrack:
    """Positions of one thing that may be a ball."""

    signal: Signal  # positions in any unit
    start_ns: int  # where the drop's clock is 0: the first sample of the log's signal
    physical: bool  # whether the preset simulates the ball itself
    ball: Ball  # what was dropped, as far as it is known

    def part(self, start_s: float | None, end_s: float | None) -> PositionTrack:
        """Select a part [s since the first sample], without samples that hold no position."""
        signal, seconds = self.signal, self.signal.seconds
        keep: NDArray[np.bool_] = np.all(np.abs(signal.values) < _FARTHEST, axis=1)  # NaN is not
        if start_s is not None:
            keep &= seconds >= start_s
        if end_s is not None:
            keep &= seconds <= end_s
        signal = _kept(signal, keep)
        if not len(signal.stamps_ns):
            raise NotFoundError(
                "no sample with a position (in the part that was selected)",
                "give --start and --end of a part in which the ball is seen, or leave them out",
            )
        return replace(self, signal=signal)

    def detect(self) -> DropDetection:
        """Detect the first drop from rest if the ball moves like that, else the first bounce."""
        signal, usual, reason = self.signal, None, None
        if not signal.counts_frames and signal.unit in ("m", UNSTATED):
            in_metres = replace(self, signal=replace(signal, unit="m"))
            try:
                usual = in_metres.from_rest(named_units(signal), _AXES.items())
            except NotFoundError as why:
                reason = why if signal.unit == "m" else None
            if usual is not None and moves_as_found(usual):
                return usual
        free = self._surely_free()
        if free is not None and (usual is None or moves_as_found(free) or not _may_be(usual)):
            return free
        if usual is None:
            what = "no free flight that ends in an impact is seen"
            raise reason or NotFoundError(what, GOOD_DROP)
        if usual.physical and not _may_be(usual):
            raise _why_not(usual)
        return usual

    def _surely_free(self) -> DropDetection | None:
        """Detect as `_free`; where that does not move as found, without samples of other things."""
        free = self._free()
        if free is not None and moves_as_found(free):
            return free
        ball = ball_alone(self.signal) if self.physical else None
        if ball is None:
            return free
        again = replace(self, signal=ball.signal)._free()
        if again is None or (free is not None and _excess(free) <= _excess(again)):
            return free
        first_s, last_s = again.found.seconds[[0, -1]]
        jumps_s = (ball.jumps_ns - self.start_ns) * 1e-9
        jumps = int(np.count_nonzero((jumps_s > first_s) & (jumps_s < last_s)))
        warnings = (*again.warnings, *ball.words)
        return replace(again, outliers=again.outliers + jumps, warnings=warnings)

    def _free(self) -> DropDetection | None:
        """Detect the drop by the gravity of the recording's own flights; None without any."""
        signal = self.signal
        if not self.physical or len(signal.stamps_ns) < 10:  # too few for a bounce
            return None
        is_timed = signal.unit in ("m", UNSTATED) and not signal.counts_frames
        shared = gravity_in(signal.seconds, signal.values)
        usual = gravity_in(signal.seconds, signal.values, GRAVITY_M_S2) if is_timed else None
        if shared is None and usual is None and signal.unit == "m" and is_timed:
            up = _likely_up(signal.values)
            usual = Gravity(GRAVITY_M_S2, up, noise_of(signal.values @ up))
        best: DropDetection | None = None
        for gravity in (shared, usual):
            found = None if gravity is None else self._falling_with(gravity)
            if found is not None and moves_as_found(found):
                return found
            best = best or found
        return best

    def _falling_with(self, gravity: Gravity) -> DropDetection | None:
        """Detect the drop by one gravity of the recording; None where there is none."""
        signal = self.signal
        along = signal.values @ gravity.up
        chains = FlownHeights(signal.seconds, along, gravity.size, gravity.noise).chains()
        if not chains:
            return None
        first = chains[0]
        depth = float(along[first.first] - along[first.impacts[0]])
        scaled = scaled_by_gravity(signal, gravity, max(depth, 1e-9))
        found = self._scaled_drop(scaled, gravity)
        if scaled.units.length_by == "gravity" and not scaled.units.doubt:
            falls = 0.0 if found is None else found.drop.gravity_m_s2 / GRAVITY_M_S2
            if abs(falls - 1) > _WITHIN_GRAVITY:  # near a unit, and not in it
                return self._scaled_drop(scaled_alone(signal, gravity), gravity) or found
        return found

    def _scaled_drop(self, scaled: Scaled, gravity: Gravity) -> DropDetection | None:
        """Detect the drop in a track of known scale: from rest if it moves so, else launched."""
        track = replace(self, signal=scaled.signal)
        try:
            usual = track.from_rest(scaled.units, [(gravity.up_name, gravity.up)])
            if moves_as_found(usual):
                return usual
        except NotFoundError:
            pass
        return track.launched(scaled.units, gravity, gravity.noise * scaled.size)

    def from_rest(self, units: Units, ups: Iterable[tuple[str, Array]]) -> DropDetection:
        """Detect the first drop of a ball that was let go at rest.

        `units` are the log's, this track's metres and seconds; of `ups`, the likeliest comes first.
        """
        signal = self.signal
        low, high = np.quantile(signal.values, (0.001, 0.999), axis=0)
        first_reason: NotFoundError | None = None
        odd: DropDetection | None = None
        for name, up in ups:
            if float(np.abs(up) @ (high - low)) < 0.5 * (high - low).max():
                continue
            along = signal.values @ up
            keep = np.logical_not(outliers(self._seconds, along))
            track = replace(self, signal=_kept(signal, keep))
            try:
                drops = find_drops(track._seconds, along[keep])
            except NotFoundError as reason:
                first_reason = first_reason or reason
                continue
            found = track._detection(drops, units, name, up, signal)
            if found.found.is_free:
                return found
            odd = odd or found
        if odd is not None:
            return odd
        raise first_reason or NotFoundError("the ball does not move", GOOD_DROP)

    def launched(self, units: Units, gravity: Gravity, noise_m: float) -> DropDetection | None:
        """Detect the first bounce between free flights that the fit explains; None without any."""
        signal, along = self.signal, self.signal.values @ gravity.up
        drops = FlownHeights(self._seconds, along, GRAVITY_M_S2, noise_m).drops()
        best: DropDetection | None = None
        for number, drop in enumerate(drops):
            others = (*drops[:number], *drops[number + 1 :])
            found = self._detection([drop], units, gravity.up_name, gravity.up, signal)
            # No single bad sample moves it.
            sunk_m = max(drop.contact_m - float(np.quantile(along, 0.005)), 0.0)
            found = replace(found, others=others, sunk_m=sunk_m)
            # From such an interval on a bounce of a thrown ball tells nothing.
            if found.posterior is None or np.ptp(found.posterior.interval95[0]) > 2 * 0.035:
                continue
            if moves_as_found(found):
                return found
            best = best or found
        return best

    @property
    def _seconds(self) -> Array:
        """Seconds since the drop's clock began."""
        return (self.signal.stamps_ns - self.start_ns).astype(np.float64) * 1e-9

    def _detection(
        self, drops: list[Drop], units: Units, name: str, up: Array, whole: Signal
    ) -> DropDetection:
        """Build the detection of the first of some drops, with its warnings."""
        drop = replace(drops[0], scale_known=units.tell_speed)
        window = slice(drop.first, drop.first + len(drop.seconds) + drop.touching)
        warnings = [] if name == "+z" else [f"up is {name} in {whole.name}"]
        if words := units_words(units):
            warnings.append(words)
        if len(drops) > 1:
            spans = ", ".join(f"{one.seconds[0]:.2f} to {one.seconds[-1]:.2f} s" for one in drops)
            warnings.append(f"{len(drops)} drops ({spans}); the first is used (see --start, --end)")
        stamps_s = (whole.stamps_ns - self.start_ns).astype(np.float64) * 1e-9
        first_s, last_s = drop.seconds[[0, -1]]
        between = int(np.count_nonzero((stamps_s >= first_s) & (stamps_s <= last_s)))
        return DropDetection(
            physical=self.physical,
            topic=whole.name,
            start_ns=self.start_ns,
            found=drop,
            outliers=between - len(drop.seconds) - drop.touching,
            sideways_m=_sideways(self.signal.values, up)[window],
            ball=self.ball,
            warnings=tuple(warnings),
            units=units,
        )


def moves_as_found(detection: DropDetection) -> bool:
    """Return whether it falls with gravity onto a table, and the fit moves as it does."""
    if not detection.physical:
        return detection.found.is_free
    if not _may_be(detection):
        return False
    falls = detection.drop.gravity_m_s2 / GRAVITY_M_S2
    return _excess(detection) < 0.5 and abs(falls - 1) < _WITHIN_GRAVITY


def is_something_else(detection: DropDetection) -> bool:
    """Return whether what was found moves so unlike a ball that it is none."""
    return detection.physical and _excess(detection) > 5.0


def _excess(detection: DropDetection) -> float:
    """Return how far the fit is off [% of the drop height]; infinite where there is none."""
    apart = fit_excess_percent(detection)
    return np.inf if apart is None else apart


def _may_be(detection: DropDetection) -> bool:
    """Return whether it falls about as bodies do, and never below where it bounced."""
    drop = detection.drop
    after_m = drop.heights_m[drop.seconds > drop.impact_s]
    # Below that it was not the table's.
    lowest_m = drop.contact_m - 0.03 * drop.drop_height_m - 6.0 * drop.noise_m
    return drop.is_free and (not len(after_m) or float(after_m.min()) > lowest_m)


def _why_not(detection: DropDetection) -> NotFoundError:
    """Explain why what falls there is no drop."""
    drop = detection.drop
    if not drop.is_free:
        return NotFoundError(
            f"falls with {drop.gravity_m_s2:.2f} m/s², and not freely on both sides of an impact: "
            "is it carried, or are the lengths in mm or cm?",
            f"{RIGHT_LENGTHS}, or {LET_GO}",
        )
    return NotFoundError(
        "no impact with free flight on both sides is seen, and it goes on below where it fell to: "
        "is it caught by hand?",
        "at the next drop: let the ball fall onto the middle of a large, level surface",
    )


def _sideways(values: Array, up: Array) -> Array:
    """Return the horizontal positions, shape (T, 2)."""
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) == 1.0:
        return np.delete(values, axis, axis=1)
    across = np.linalg.svd(up[None, :])[2][1:]
    return values @ across.T
