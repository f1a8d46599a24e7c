"""Model a bouncing ball seen by a camera or by motion capture: its unknowns and their priors.

The ball is in closed form (`Bounce`): its restitution e at the first impact, how that falls with
speed, and the air's drag. The camera is a projective map of the vertical: a height u [drop heights]
above contact appears at A + B phi(u), phi(u) = e^k u / (1 + (e^k - 1) u). A ball that also goes
sideways changes its distance by a fraction d, and appears at A + (B e^k u + C d) / (1 + (e^k - 1) u
+ d): a pinhole that looks along a slope. A lens bends both by the cube of the distance from the
picture's centre (`Lens`). Recorded positions are a film whose camera is known: no
perspective k, and the span B is the drop height, as far as the log's metres are metres. Impacts
that were heard, too, are further measurements (`AudioImpacts`): the sound is late by an offset that
is unknown, and contacts last.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.times.model import since_impacts_s
from tunenet_logs.analysis.drop.times.readings import KNOWN_DRAG
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.ball import MIN_SPEED_M_S, Bounce, flown_by
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# By how much sound may be late, or early, beside the pictures: what phones and cameras do.
OFFSET_SD_S = 0.1
# How long a contact lasts: from .3 ms (steel on glass) to 8 ms (a soft ball on a table).
TOUCH_S, TOUCH_SD_S = 0.002, 0.0025
SOFT_SD_S = 0.008  # likewise, where pictures show that it lasts
HEARD_FREEDOM = 4.0  # degrees of freedom of Student's t of a heard time: an onset may be an echo's
# Prior probability of each standard deviation of an impact's own restitution about the law, as a
# fraction of it.
SCATTERS = {0.0005: 0.5, 0.002: 0.3, 0.006: 0.15, 0.02: 0.05}


@dataclass(frozen=True, eq=False)
class AudioImpacts:
    """Times at which the ball is heard to touch the table."""

    numbers: NDArray[np.intp]  # of the impacts, 0 the first of the drop, shape (N,)
    times_s: Array  # on the samples' clock, but late by an offset, shape (N,)
    sds_s: Array  # standard deviations of the onsets, shape (N,)
    scatter: float = 0.0  # of each impact's own restitution about the law, as a fraction

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the times about a law's [s²]: a faster return delays all that follows."""
        later_s = since_impacts_s(self.times_s, self.numbers)
        return np.diag(self.sds_s**2) + self.scatter**2 * later_s @ later_s.T

    @cached_property
    def whitening(self) -> Array:
        """Whitening matrix of the times' residuals, shape (N, N)."""
        rows = np.linalg.inv(np.linalg.cholesky(self.covariance))
        return np.asarray(rows, dtype=np.float64)

    def only(self, chosen: NDArray[np.bool_]) -> AudioImpacts:
        """Return the touches of a mask, shape (N,)."""
        return replace(
            self,
            numbers=self.numbers[chosen],
            times_s=self.times_s[chosen],
            sds_s=self.sds_s[chosen],
        )

    def beside(self, more: AudioImpacts) -> AudioImpacts:
        """Append other touches, which come later."""
        return replace(
            self,
            numbers=np.concatenate([self.numbers, more.numbers]),
            times_s=np.concatenate([self.times_s, more.times_s]),
            sds_s=np.concatenate([self.sds_s, more.sds_s]),
        )


# ---- Priors and measurements, each on one linear combination of the unknowns


@dataclass(frozen=True)
class Prior:
    """Prior on one linear combination of the unknowns."""

    slopes: dict[int, float]  # of the combination over the unknowns in it, by index
    off: float  # from the likeliest
    sd: float  # standard deviation
    freedom: float = np.inf  # of Student's t; infinite for a normal distribution
    measured: bool = False  # whether it is a measurement, not a prior of balls and cameras

    @property
    def cost(self) -> float:
        """Negative log density, without constants."""
        square = (self.off / self.sd) ** 2
        if math.isinf(self.freedom):
            return 0.5 * square
        return 0.5 * (self.freedom + 1) * math.log1p(square / self.freedom)

    @property
    def weight(self) -> float:
        """Weight of its squared residual, where t is fitted by reweighting."""
        if math.isinf(self.freedom):
            return self.sd**-2
        square = (self.off / self.sd) ** 2
        return (self.freedom + 1) / (self.freedom + square) / self.sd**2


# ---- Lens: radial distortion of the first order along the image's vertical (Brown 1971)


@dataclass(frozen=True)
class Lens:
    """Lens that moves what is half a picture off its centre by a fraction of that."""

    distortion: float = 0.0
    center: float = 0.0  # of the picture, along the vertical
    reach: float = 1.0  # half the picture's longer side

    def _off(self, positions: Array) -> Array:
        return (positions - self.center) / self.reach

    def moves(self, positions: Array) -> Array:
        """Return by how much a distortion of 1 moves what a pinhole sees, shape (T,)."""
        return self._off(positions) ** 3 * self.reach

    def stretch(self, positions: Array) -> Array:
        """Return by how much it magnifies there, shape (T,)."""
        return 1 + 3 * self.distortion * self._off(positions) ** 2

    def seen(self, positions: Array) -> Array:
        """Return where it shows what a pinhole sees at these positions, shape (T,)."""
        return positions + self.distortion * self.moves(positions) if self.distortion else positions

    def straight(self, seen: Array) -> Array:
        """Return where a pinhole sees what it shows, shape (T,), by Newton's method."""
        if not self.distortion:
            return seen
        positions = seen
        for _ in range(4):  # a distortion is a small part of a picture
            positions = positions - (self.seen(positions) - seen) / self.stretch(positions)
        return positions


# ---- Uncalibrated camera: a projective map of the vertical (Hartley and Zisserman 2004)
# Three points fix the map of a line, and it keeps the cross-ratio of four.

PERSPECTIVE_SD = 0.7  # prior of k, normal about 0: from the camera poses that people use
_NEAREST = 1e-3  # least depth [depth of the contact]: a height above the camera has no image


@dataclass(frozen=True, eq=False)
class Projection:
    """Camera along the image's vertical, and the ball that it sees."""

    contact: float  # A, along the image's vertical, up positive
    span: float  # B
    perspective: float  # k
    impact_s: float  # the first impact [s]
    fall_time_s: float  # T0, without air [s]
    bounce: Bounce  # the ball
    residual_rms: float  # root mean square of the track's residuals
    # From when on [s] its distance grows by how much a second, as a fraction of that of the start,
    # each on top of the others.
    moves: tuple[tuple[float, float], ...] = ()
    lift: float = 0.0  # C, see the module
    # By how much the camera's roll lowers it along the vertical at these times.
    leans: tuple[Array, Array] = (np.zeros(1), np.zeros(1))
    lens: Lens = Lens()

    def farther(self, seconds: Array) -> Array:
        """Return the change of distance d at these times, shape (T,)."""
        return since_moves(seconds, [at for at, _ in self.moves]) @ [one for _, one in self.moves]

    def heights(self, positions: Array, seconds: Array) -> Array:
        """Convert positions along the vertical at these times to [drop heights], shape (T,)."""
        positions, grow = self.lens.straight(positions), self._grow
        seen = positions + np.interp(seconds, *self.leans) - self.contact
        farther = self.farther(seconds)
        rises = self.span * grow - (grow - 1) * seen
        return (seen * (1 + farther) - self.lift * farther) / np.maximum(
            rises, _NEAREST * self.span
        )

    def positions(self, heights: Array, seconds: Array) -> Array:
        """Project heights [drop heights] at these times onto the vertical, shape (T,)."""
        farther, grow = self.farther(seconds), self._grow
        depth = np.maximum(1 + (grow - 1) * heights + farther, _NEAREST)
        seen = self.contact + (self.span * grow * heights + self.lift * farther) / depth
        return self.lens.seen(seen - np.interp(seconds, *self.leans))

    def straightened(self, positions: Array, seconds: Array) -> Array:
        """Return where a pinhole would see it if it went neither sideways nor away, shape (T,)."""
        heights = self.heights(positions, seconds)
        return self.contact + self.span * projected(heights, self.perspective)

    @property
    def _grow(self) -> float:
        return float(np.exp(self.perspective))

    def ball(self, seconds: Array) -> Array:
        """Return where the ball is at these times, along the vertical, shape (T,)."""
        return self.positions(self.bounce.heights(self.fall_times(seconds)), seconds)

    def touches(self, seconds: Array, beside_s: float = 0.0) -> NDArray[np.bool_]:
        """Return at which times a contact lasts, or is as near, shape (T,)."""
        times, beside = self.fall_times(seconds), beside_s / self.fall_time_s
        ends, _ = self.bounce.flights(float(times.max(initial=0.0)))
        begins = ends - self.bounce.contact - beside
        at = np.searchsorted(begins, times, side="right") - 1
        return (at >= 0) & (times < ends[np.maximum(at, 0)] + beside)

    def fall_times(self, seconds: Array) -> Array:
        """Convert times [s] to times [fall times after the first impact], shape (T,)."""
        return (seconds - self.impact_s) / self.fall_time_s

    def impacts(self, until_s: float) -> Array:
        """Return all impacts until then, in order [fall times after the first]; the first is 0."""
        last = (until_s - self.impact_s) / self.fall_time_s
        starts, _ = self.bounce.flights(last)
        return starts[starts <= max(last, 0.0)]


def since_moves(seconds: Array, moves_s: Sequence[float]) -> Array:
    """Return the time since each move, 0 before it, shape (T, N) [s]."""
    return np.maximum(seconds[:, None] - np.array(moves_s), 0.0)


def projected(heights: Array, perspective: float | Array, nearest: float = _NEAREST) -> Array:
    """Evaluate phi(u) at heights [drop heights]; k broadcasts with them."""
    grow = np.exp(perspective)
    return grow * heights / np.maximum(1 + (grow - 1) * heights, nearest)


def ideal_heights(restitution: Array, times: Array) -> Array:
    """Compute heights [drop heights] of an airless ball of one restitution, at times [fall times].

    Both broadcast; 0 is the first impact, after a fall from rest.
    """
    after = np.maximum(times, 0.0)
    bouncing = 1 - after * (1 - restitution) / (2 * np.maximum(restitution, 1e-9))
    kept = np.clip(restitution, 1e-9, 1 - 1e-9)  # `bouncing` is e^n when flight n begins
    speeds = kept ** np.floor(np.log(np.maximum(bouncing, 1e-12)) / np.log(kept))
    since = after - 2 * kept * (1 - speeds) / (1 - kept)
    flying = np.where(bouncing > 0, np.maximum(since * (2 * kept * speeds - since), 0.0), 0.0)
    return np.where(times < 0, 1 - np.maximum(times + 1, 0.0) ** 2, flying)


# ---- Unknowns of a bounce, and the samples that they are fitted to

# Indices of the unknowns: e, t1 [s], log T0, A, B, k, p, drag times drop height. A and B are in the
# positions' unit. The unknowns from 8 on are the moves, see `BounceSamples`.
RESTITUTION, IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE, SLOPE, DRAG = range(8)
# By how much the sound is late, where impacts are heard, and how long a contact lasts [s].
OFFSET, TOUCH = 15, 16
# Of a ball that goes sideways: the log of the camera's focal length over the usual, its roll [rad].
FOCAL, ROLL = 17, 18
LENS = 19  # by how much a lens moves what is half a picture off its centre, as a fraction of that
# What is fitted first, roughly, of a film: a ball that keeps its restitution, without air.
IDEAL = (RESTITUTION, IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE)
SLOPE_SD = 0.1  # of the slope p, normal about 0, while fitting: real balls show .03 to .22
DRAG_SD_1_M = 0.1  # of the drag, likewise: a table-tennis ball has .13, most others about .02
# Of the log of a length in the log over the true one: gravity differs by .1 % between most places
# of the earth. Student's t, because some logs' lengths are scaled by hand.
METRE_SD, METRE_FREEDOM = 0.0008, 2.0
ANY_SCALE_SD = 0.5  # the same where only the fall itself tells the unit
# Of the rate at which a ball's distance changes from an impact on, as a fraction a fall time: by
# spin, a hand, or a table that is not level.
MOVE_SD, MOVE_FREEDOM = 0.04, 2.0  # Student's t: few balls are kicked hard
# Of a focal length over the picture's longer side: lenses of 50 to 75 degrees, and zooms.
USUAL_FOCAL, FOCAL_SD = 0.85, 0.35
ROLL_SD = 0.02  # of the vertical that a tracker finds [rad]
LENS_SD = 0.01  # normal about 0: phones correct theirs, webcams and action cameras do not
_KNOWN = 8  # unknowns that have a name
# Degrees of freedom of Student's t: nearly normal; 10 standard deviations off, a tenth counts.
FREEDOM = 8.0
MAX_MOVES = 7  # of which the first is when it is let go
# Bounds of the unknowns: wider than any real ball or camera.
_ANY = [-np.inf] * (MAX_MOVES + 1)
LOW = np.array([0.005, *[-np.inf] * 3, 0.0, -2.5, -0.3, 0.0, *_ANY, 0.0, -0.8, -0.2, -0.2])
HIGH = np.array([1.0, *[np.inf] * 4, 2.5, 0.5, 2.0, *np.negative(_ANY), 0.02, 0.8, 0.2, 0.2])
_SHORT = 1e-5  # of an unknown of the ball, or of time [fall times], by which it is differentiated


def nudged(unknowns: Array, index: int, by: float) -> tuple[Array, float]:
    """Move one unknown, back if it would leave its bounds; return all of them and by how much."""
    moved = unknowns.copy()
    moved[index] += by if unknowns[index] < HIGH[index] - by else -by
    return moved, moved[index] - unknowns[index]


class Flown(NamedTuple):
    """Ball of some unknowns at the samples' times, and those nudged by its free unknowns."""

    unknowns: Array  # shape (20,)
    free: tuple[int, ...]
    times: Array  # [fall times after the first impact], shape (T,)
    heights: Array  # [drop heights], shape (T,)
    speeds: Array  # upward [drop heights, fall times], shape (T,)
    # by unknown: by how much it was nudged, and the heights then, shape (T,)
    nudged: dict[int, tuple[float, Array]]


@dataclass(frozen=True, eq=False)
class BounceSamples:
    """Samples that a bounce is fitted to, and what is known of them."""

    seconds: Array  # shape (T,)
    # Along the vertical, up positive, in px of a picture or m of a log, shape (T,).
    positions: Array
    noise: float  # standard deviation of a position, at least
    in_metres: bool = False  # whether the positions are heights, and not of a picture
    scale_known: bool = True  # whether heights are in true metres, as far as a log's metres are
    starts_in_flight: bool = False  # whether the ball flew before the first sample, too
    # Share of a lens's distortion in the noise's variance.
    distortion_variance_fraction: float = 0.0
    drag_1_m: float | None = None  # drag that is known [1/m]; None where it is not
    exposure_s: float = 0.0  # for which a shutter may have been open, around the time of a sample
    # Moments [s] from which on the ball's distance may change at another rate: when it is let go,
    # and impacts. Each is an unknown, the rate in `MOVE_SD` a fall time.
    moves_s: tuple[float, ...] = ()
    # What the rates are by the ball's size, in `MOVE_SD` a fall time, and their covariance, shape
    # (N,) and (N, N); None where no sizes are known.
    sized: tuple[Array, Array] | None = None
    across: Array | None = None  # positions across the vertical, shape (T,); None where not known
    radii: Array | None = None  # of the ball, NaN where not known, shape (T,)
    center: float = 0.0  # where the picture's centre is along the vertical
    usual_focal: float = 1.0  # a usual focal length, in the positions' unit
    through_lens: bool = False  # whether the lens's distortion is an unknown
    is_soft: bool = False  # whether contacts last long enough to be seen
    heard: AudioImpacts | None = None  # impacts that were heard, too; None where none were

    @property
    def unknowns(self) -> tuple[int, ...]:
        """Indices of the unknowns that can be fitted to the samples."""
        ball = (RESTITUTION, IMPACT, FALL, CONTACT, SPAN, SLOPE, DRAG)
        seen = ball if self.in_metres else (*IDEAL, SLOPE, DRAG)
        if self.moves_s:
            seen = (*seen, *self.moving, FOCAL, ROLL)
        seen = (*seen, LENS) if self.through_lens else seen
        heard = () if self.heard is None else (OFFSET,)
        return (*seen, *heard, *((TOUCH,) if self.lasts else ()))

    @cached_property
    def log_radii(self) -> Array:
        """Logarithm of the ball's radius, NaN where that is not known, shape (T,)."""
        radii = np.full(len(self.seconds), np.nan) if self.radii is None else self.radii
        return np.log(np.where(radii > 0, radii, np.nan))

    @property
    def sized_samples(self) -> NDArray[np.bool_]:
        """Whether the ball's radius is known, shape (T,)."""
        return np.isfinite(self.log_radii)

    @property
    def moving(self) -> tuple[int, ...]:
        """Indices of the rates at which the ball's distance changes."""
        return tuple(range(_KNOWN, _KNOWN + len(self.moves_s)))

    @property
    def lasts(self) -> bool:
        """Whether the duration of contacts is an unknown."""
        return self.is_soft or self.heard is not None

    def part(self, first: int, last: int) -> BounceSamples:
        """Return the samples from index `first` on, before `last`."""
        return self.only(slice(first, last))

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | slice) -> BounceSamples:
        """Return the samples of a mask, shape (T,), of indices or of a range."""
        return replace(
            self,
            seconds=self.seconds[chosen],
            positions=self.positions[chosen],
            across=None if self.across is None else self.across[chosen],
            radii=None if self.radii is None else self.radii[chosen],
        )

    def moving_until(self, count: int) -> BounceSamples:
        """Return the samples of a ball that moves otherwise at the first `count` moments alone."""
        sized = self.sized and (self.sized[0][:count], self.sized[1][:count, :count])
        return replace(self, moves_s=self.moves_s[:count], sized=sized if count else None)

    def off_by_size(self, unknowns: Array) -> Array:
        """Return how far the rates are from what the ball's size says, (N,); infinite without."""
        if self.sized is None:
            return np.array([np.inf])
        return np.asarray(self._whitening @ (unknowns[list(self.moving)] - self.sized[0]))

    @cached_property
    def _whitening(self) -> Array:
        assert self.sized is not None
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.sized[1])), dtype=np.float64)

    def bounce(self, unknowns: Array) -> Bounce:
        """Build the ball of these unknowns, shape (20,)."""
        restitution, slope, drag = unknowns[[RESTITUTION, SLOPE, DRAG]].tolist()
        first, fall_s = Bounce(restitution, drag=drag).impact_speed, math.exp(unknowns[FALL])
        return Bounce(
            restitution,
            slope,
            drag,
            constant_below=MIN_SPEED_M_S / (first * (GRAVITY_M_S2 * fall_s / 2)),
            starts_in_flight=self.starts_in_flight,
            contact=float(unknowns[TOUCH]) / fall_s if self.lasts else 0.0,
        )

    def residuals(self, unknowns: Array) -> Array:
        """Return predicted less seen positions, (T,), of unknowns (20,)."""
        return self.seen_of([self.bounce(unknowns)], unknowns)[0] - self.positions

    def seen_of(self, balls: Sequence[Bounce], unknowns: Array) -> Array:
        """Return where balls are along the vertical, (K, T), all else as in the unknowns, (20,)."""
        times = np.tile(self.times(unknowns), (len(balls), 1))
        return self.lens(unknowns).seen(self._predicted(unknowns, flown_by(balls, times)[0]))

    def lens(self, unknowns: Array) -> Lens:
        """Return the lens of these unknowns, shape (20,)."""
        return Lens(float(unknowns[LENS]), self.center, self.usual_focal / (2 * USUAL_FOCAL))

    def _predicted(self, unknowns: Array, heights: Array) -> Array:
        """Return where a pinhole sees the ball along the vertical at these heights, (..., T)."""
        if not self.moves_s:
            shape = projected(heights, float(unknowns[PERSPECTIVE]))
            return unknowns[CONTACT] + unknowns[SPAN] * shape
        grow, farther = float(np.exp(unknowns[PERSPECTIVE])), self.farther(unknowns)
        depth = np.maximum(1 + (grow - 1) * heights + farther, _NEAREST)
        seen = (unknowns[SPAN] * grow * heights + self.lift(unknowns) * farther) / depth
        return unknowns[CONTACT] + seen - self.lean(unknowns)

    def farther(self, unknowns: Array) -> Array:
        """Return the change of the ball's distance, as a fraction of the start's, (T,)."""
        return self._since_moves_s @ self.rates(unknowns)

    def rates(self, unknowns: Array) -> Array:
        """Return the rates at which the distance changes, each on top of the others [1/s], (N,)."""
        own = unknowns[_KNOWN : _KNOWN + len(self.moves_s)]
        return np.asarray(own * MOVE_SD / np.exp(unknowns[FALL]), dtype=np.float64)

    def lift(self, unknowns: Array) -> float:
        """Return C, see the module: a pinhole's, of this focal length, that sees A, B and k."""
        if not self.moves_s:
            return 0.0
        grow, low = float(np.exp(unknowns[PERSPECTIVE])), float(unknowns[CONTACT]) - self.center
        span, focal = float(unknowns[SPAN]), self.usual_focal * float(np.exp(unknowns[FOCAL]))
        level = max(span * grow + low * (grow - 1), 0.1 * span)  # of the optical axis, cosine
        return -low - (grow - 1) * focal**2 / level

    def lean(self, unknowns: Array) -> Array:
        """Return by how much the camera's roll lowers the ball along the vertical, shape (T,)."""
        if self.across is None or not self.moves_s:
            return np.zeros(len(self.seconds))
        return unknowns[ROLL] * self.across

    @cached_property
    def _since_moves_s(self) -> Array:
        return since_moves(self.seconds, self.moves_s)

    def flown(self, unknowns: Array, free: tuple[int, ...]) -> Flown:
        """Fly the ball of some unknowns, (20,), and those that its free unknowns are nudged to."""
        nudges = {
            index: nudged(unknowns, index, _SHORT)
            for index in (RESTITUTION, SLOPE, DRAG, TOUCH)
            if index in free
        }
        times = self.times(unknowns)
        balls = [self.bounce(one) for one in (unknowns, *(moved for moved, _ in nudges.values()))]
        places = np.empty((len(balls), len(times)))
        places[:] = times
        (heights, *others), (speeds, *_) = flown_by(balls, places)
        moved = {
            index: (by, one) for (index, (_, by)), one in zip(nudges.items(), others, strict=True)
        }
        return Flown(unknowns, free, times, heights, speeds, moved)

    def residuals_of(self, flown: Flown) -> Array:
        """Return predicted less seen positions, shape (T,)."""
        predicted = self._predicted(flown.unknowns, flown.heights)
        return self.lens(flown.unknowns).seen(predicted) - self.positions

    def jacobian(self, unknowns: Array, free: tuple[int, ...]) -> Array:
        """Return the residuals' Jacobian over the free unknowns, shape (T, len(free))."""
        return self.jacobian_of(self.flown(unknowns, free))

    def jacobian_of(self, flown: Flown) -> Array:
        """Return the residuals' Jacobian over the free unknowns, shape (T, len(free))."""
        unknowns, free, times, heights, speeds, nudges = flown
        grow = float(np.exp(unknowns[PERSPECTIVE]))
        farther = self.farther(unknowns) if self.moves_s else np.zeros(len(times))
        depth = np.maximum(1 + (grow - 1) * heights + farther, _NEAREST)
        rises = unknowns[SPAN] * grow * (1 + farther) - (grow - 1) * self.lift(unknowns) * farther
        per_height = rises / depth**2
        columns = {
            CONTACT: np.ones(len(times)),
            SPAN: grow * heights / depth,
            PERSPECTIVE: per_height * heights * (1 - heights),
        }
        if self.moves_s:
            usual = self._predicted(unknowns, heights)
            for index in (CONTACT, SPAN, PERSPECTIVE, FOCAL, ROLL, *self.moving):
                by = 1e-6 * (float(unknowns[SPAN]) if index in (CONTACT, SPAN) else 1.0)
                moved = unknowns.copy()
                moved[index] += by
                columns[index] = (self._predicted(moved, heights) - usual) / by
        for index, (by, moved) in nudges.items():
            columns[index] = per_height * (moved - heights) / by
        columns[IMPACT] = -per_height * speeds / np.exp(unknowns[FALL])
        columns[FALL] = -per_height * speeds * times
        # Rates and contacts are in fall times.
        for index in (*self.moving, TOUCH):
            if index in columns:
                columns[FALL] = columns[FALL] - unknowns[index] * columns[index]
        if LENS in free:
            lens = self.lens(unknowns)
            seen = self._predicted(unknowns, heights)
            columns = {index: lens.stretch(seen) * column for index, column in columns.items()}
            columns[LENS] = lens.moves(seen)
        if OFFSET in free:
            columns[OFFSET] = np.zeros(len(times))
        return np.column_stack([columns[index] for index in free])

    def times(self, unknowns: Array) -> Array:
        """Return the sample times [fall times after the first impact], shape (T,)."""
        return (self.seconds - unknowns[IMPACT]) / np.exp(unknowns[FALL])

    def touches_s(
        self, unknowns: Array, numbers: NDArray[np.intp], ball: Bounce | None = None
    ) -> Array:
        """Return when impacts begin, by their numbers from 0 [s], shape (N,)."""
        ball, fall_s = ball or self.bounce(unknowns), float(np.exp(unknowns[FALL]))
        last = max(float(self.seconds[-1] - unknowns[IMPACT]) / fall_s, 0.0)
        starts, _ = ball.flights(1.5 * last + 1)  # an impact may be heard after the last sample
        which = np.minimum(numbers, len(starts) - 1)
        return unknowns[IMPACT] + fall_s * (starts[which] - ball.contact)

    def priors(self, unknowns: Array) -> list[Prior]:
        """Return the priors of the unknowns, and the heard impacts as measurements."""

        def about(index: int, usual: float, sd: float) -> Prior:
            return Prior({index: 1.0}, float(unknowns[index] - usual), sd)

        # Of balls, metres and cameras.
        height_m = GRAVITY_M_S2 * float(np.exp(2 * unknowns[FALL])) / 2
        usual, sd_1_m = 0.0, DRAG_SD_1_M
        if self.drag_1_m is not None:
            usual, sd_1_m = self.drag_1_m, KNOWN_DRAG * self.drag_1_m
        found = [about(SLOPE, 0.0, SLOPE_SD), about(DRAG, usual * height_m, sd_1_m * height_m)]
        if self.in_metres:
            off = float(np.log(unknowns[SPAN] / height_m))
            sd, freedom = (METRE_SD, METRE_FREEDOM) if self.scale_known else (ANY_SCALE_SD, np.inf)
            found.append(Prior({SPAN: 1 / float(unknowns[SPAN]), FALL: -2.0}, off, sd, freedom))
        else:
            found.append(about(PERSPECTIVE, 0.0, PERSPECTIVE_SD))
        if self.moves_s:
            moves = unknowns[list(self.moving)].tolist()
            found += [
                Prior({index: 1.0}, rate, 1.0, MOVE_FREEDOM)
                for index, rate in zip(self.moving, moves, strict=True)
            ]
            found += [about(FOCAL, 0.0, FOCAL_SD), about(ROLL, 0.0, ROLL_SD)]
        if self.through_lens:
            found.append(about(LENS, 0.0, LENS_SD))
        if self.sized is not None:
            off = self.off_by_size(unknowns)
            for row, one in zip(self._whitening.tolist(), off.tolist(), strict=True):
                rates = dict(zip(self.moving, row, strict=True))
                found.append(Prior(rates, one, 1.0, HEARD_FREEDOM))
        if self.lasts:
            found.append(about(TOUCH, TOUCH_S, SOFT_SD_S if self.is_soft else TOUCH_SD_S))
        if self.heard is None:
            return found
        # Of the sound's offset and the contacts, and the times as measurements.
        heard = self.heard
        times_s = self.touches_s(unknowns, heard.numbers)
        slopes: dict[int, Array] = {}
        for index in (RESTITUTION, SLOPE, DRAG):
            moved, by = nudged(unknowns, index, _SHORT)
            slopes[index] = (self.touches_s(moved, heard.numbers) - times_s) / by
        slopes[TOUCH] = heard.numbers.astype(np.float64)
        slopes[FALL] = times_s - unknowns[IMPACT] - slopes[TOUCH] * unknowns[TOUCH]
        slopes[IMPACT] = slopes[OFFSET] = np.ones(len(times_s))
        off_s = times_s + unknowns[OFFSET] - heard.times_s
        found.append(about(OFFSET, 0.0, OFFSET_SD_S))
        white = heard.whitening
        moves = {index: (white @ each).tolist() for index, each in slopes.items()}
        for at, off in enumerate((white @ off_s).tolist()):
            row = {index: each[at] for index, each in moves.items()}
            found.append(Prior(row, off, 1.0, HEARD_FREEDOM, measured=True))
        return found
