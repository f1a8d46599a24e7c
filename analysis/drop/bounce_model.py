"""Bouncing ball seen by a camera or by motion capture: its unknowns and their priors.

The ball is in closed form (`Bounce`): its restitution e at the first impact, how that falls with
speed, and the air's drag. The camera is a projective map of the vertical (`Projection`). Recorded
positions are a film whose camera is known: it has no perspective, and its span is the drop height,
as far as the log's metres are metres. Impacts that were heard, too, are further measurements
(`HeardTouches`): the sound is late by an offset that is unknown, and contacts last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.drop.heard_touches import (
    HEARD_FREEDOM,
    OFFSET_SD_S,
    TOUCH_S,
    TOUCH_SD_S,
    HeardTouches,
)
from analysis.drop.prior import Prior
from analysis.drop.projection import PERSPECTIVE_SD, projected
from recorders.simulators.base import GRAVITY_M_S2
from recorders.simulators.closed_form.bounce import Bounce
from recorders.simulators.speed_law import MIN_SPEED_M_S
from tunenet_logs.arrays import Array

# Indices of the unknowns: e, t1 [s], log T0, A, B, k, p, drag times drop height.
#
# A and B are in the positions' unit. The unknowns from 8 on are the bends, see `BounceSamples`.
RESTITUTION, IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE, SLOPE, DRAG = range(8)

# Those of impacts that are heard: by how much the sound is late, how long a contact lasts [s].
OFFSET, TOUCH = 14, 15

# What is fitted first, roughly, of a film: a ball that keeps its restitution, without air.
IDEAL = (RESTITUTION, IMPACT, FALL, CONTACT, SPAN, PERSPECTIVE)

SLOPE_SD = 0.1  # of the slope p, normal about 0, while fitting: real balls show .03 to .22
DRAG_SD_1_M = 0.1  # of the drag, likewise: a table-tennis ball has .13, most others about .02
KNOWN_DRAG = 0.1  # fraction by which a drag may be off that follows from a ball's mass and size
# Of the log of a length in the log over the true one: gravity differs by .1 % between most places
# of the earth. Student's t, because some logs' lengths are scaled by hand.
METRE_SD, METRE_FREEDOM = 0.0008, 2.0

ANY_SCALE_SD = 0.5  # the same where only the fall itself tells the unit
# Of the rate at which contact moves through the picture after an impact, B a fall time: a ball that
# falls 1 m goes sideways by some .1 m/s more or less after each bounce.
BEND_SD = 0.008

_KNOWN = 8  # unknowns that have a name
# Degrees of freedom of Student's t: nearly normal; 10 standard deviations off, a tenth counts.
FREEDOM = 8.0

MAX_BENDS = 6  # impacts at which the contact may begin to move
_ANY, _HEARD_LOW, _HEARD_HIGH = [np.inf] * MAX_BENDS, (-np.inf, 0.0), (np.inf, 0.02)
LOW = np.array([0.005, *[-np.inf] * 3, 0.0, -2.5, -0.3, 0.0, *np.negative(_ANY), *_HEARD_LOW])
# Of the unknowns, beyond what any ball or camera has.
HIGH = np.array([1.0, *[np.inf] * 4, 2.5, 0.5, 2.0, *_ANY, *_HEARD_HIGH])

_SHORT = 1e-5  # of an unknown of the ball, or of time [fall times], by which it is differentiated
_FARTHER = 1.5  # how much later than the last sample an impact may be that was heard


@dataclass(frozen=True, eq=False)
class BounceSamples:
    """Samples that a bounce is fitted to, and what is known of them.

    Attributes:
        seconds: shape (T,).
        positions: along the vertical, up positive, in px of a picture or m of a log, shape (T,).
        noise: standard deviation of a position, at least.
        in_metres: whether the positions are heights, and not of a picture.
        scale_known: whether heights are in true metres, as far as a log's metres are.
        flies_in: whether the ball flew before the first sample, too.
        distortion_variance_fraction: share of a lens's distortion in the noise's variance.
        drag_1_m: drag that is known [1/m]; None where it is not.
        exposure_s: for which a shutter may have been open, around the time of a sample.
        bends_s: moments [s] from which on the contact may move through the picture: impacts. Each
            is an unknown, the rate in `BEND_SD` B a fall time.
        heard: impacts that were heard, too; None where none were.
    """

    seconds: Array
    positions: Array
    noise: float
    in_metres: bool = False
    scale_known: bool = True
    flies_in: bool = False
    distortion_variance_fraction: float = 0.0
    drag_1_m: float | None = None
    exposure_s: float = 0.0
    bends_s: tuple[float, ...] = ()
    heard: HeardTouches | None = None

    @property
    def own_noise(self) -> float:
        """Noise without its share of lens distortion."""
        return self.noise * float(np.sqrt(1 - self.distortion_variance_fraction))

    @property
    def unknowns(self) -> tuple[int, ...]:
        """Indices of the unknowns that can be fitted to the samples."""
        ball = (RESTITUTION, IMPACT, FALL, CONTACT, SPAN, SLOPE, DRAG)
        bends = range(_KNOWN, _KNOWN + len(self.bends_s))
        seen = ball if self.in_metres else (*IDEAL, SLOPE, DRAG, *bends)
        return seen if self.heard is None else (*seen, OFFSET, TOUCH)

    def part(self, first: int, last: int) -> BounceSamples:
        """Return the samples from index `first` on, before `last`."""
        return replace(self, seconds=self.seconds[first:last], positions=self.positions[first:last])

    def only(self, chosen: NDArray[np.bool_]) -> BounceSamples:
        """Return the samples of a mask, shape (T,)."""
        return replace(self, seconds=self.seconds[chosen], positions=self.positions[chosen])

    def bounce(self, unknowns: Array) -> Bounce:
        """Build the ball of these unknowns, shape (16,)."""
        ball = Bounce(float(unknowns[RESTITUTION]), float(unknowns[SLOPE]), float(unknowns[DRAG]))
        unit_m_s = GRAVITY_M_S2 * float(np.exp(unknowns[FALL])) / 2
        slowest = MIN_SPEED_M_S / (ball.impact_speed * unit_m_s)
        return Bounce(
            ball.restitution,
            ball.slope,
            ball.drag,
            constant_below=slowest,
            flies_in=self.flies_in,
            contact=float(unknowns[TOUCH] / np.exp(unknowns[FALL])) if self.heard else 0.0,
        )

    def residuals(self, unknowns: Array, ball: Bounce | None = None) -> Array:
        """Return predicted less seen positions, (T,), of unknowns (16,) or of another `ball`."""
        heights = (ball or self.bounce(unknowns)).heights(self.times(unknowns))
        shape = projected(heights, float(unknowns[PERSPECTIVE]))
        return unknowns[CONTACT] + unknowns[SPAN] * shape + self._moved(unknowns) - self.positions

    def bend_rates(self, unknowns: Array) -> Array:
        """Return the contact's speed from each bend on, in the positions' unit/s, shape (N,)."""
        unit = BEND_SD * unknowns[SPAN] / np.exp(unknowns[FALL])
        return unit * unknowns[_KNOWN : _KNOWN + len(self.bends_s)]

    def _moved(self, unknowns: Array) -> Array:
        """Return how far the contact has moved, shape (T,)."""
        if not self.bends_s:
            return np.zeros(len(self.seconds))
        return self._since() @ self.bend_rates(unknowns)

    def _since(self) -> Array:
        """Return the seconds since each bend, shape (T, N)."""
        return np.maximum(self.seconds[:, None] - np.array(self.bends_s), 0.0)

    def jacobian(self, unknowns: Array, free: tuple[int, ...]) -> Array:
        """Return the residuals' Jacobian over the free unknowns, shape (T, len(free))."""
        times = self.times(unknowns)
        timed = IMPACT in free or FALL in free
        at = np.concatenate([times, times + _SHORT]) if timed else times
        heights, later = np.split(self.bounce(unknowns).heights(at), [len(times)])
        grow = float(np.exp(unknowns[PERSPECTIVE]))
        depth = np.maximum(1 + (grow - 1) * heights, 1e-3)
        per_height = unknowns[SPAN] * grow / depth**2
        columns = {
            CONTACT: np.ones(len(times)),
            SPAN: grow * heights / depth,
            PERSPECTIVE: per_height * heights * (1 - heights),
        }
        for index in {RESTITUTION, SLOPE, DRAG, TOUCH}.intersection(free):
            moved = unknowns.copy()
            moved[index] += _SHORT if unknowns[index] < HIGH[index] - _SHORT else -_SHORT
            rise = self.bounce(moved).heights(times) - heights
            columns[index] = per_height * rise / (moved[index] - unknowns[index])
        if timed:
            speeds = (later - heights) / _SHORT
            columns[IMPACT] = -per_height * speeds / np.exp(unknowns[FALL])
            columns[FALL] = -per_height * speeds * times
        if self.bends_s:
            unit = BEND_SD * unknowns[SPAN] / np.exp(unknowns[FALL])
            columns |= dict(enumerate((unit * self._since()).T, start=_KNOWN))
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
        starts, _ = ball.flights(_FARTHER * last + 1)
        which = np.minimum(numbers, len(starts) - 1)
        return unknowns[IMPACT] + fall_s * (starts[which] - ball.contact)

    def priors(self, unknowns: Array) -> list[Prior]:
        """Return the priors of the unknowns, and the heard impacts as measurements."""
        likely = self._likely(unknowns)
        return likely if self.heard is None else [*likely, *self._heard(self.heard, unknowns)]

    def _heard(self, heard: HeardTouches, unknowns: Array) -> list[Prior]:
        """Return the heard impact times as measurements, and the priors of offset and contact."""
        times_s = self.touches_s(unknowns, heard.numbers)
        slopes: dict[int, Array] = {}
        for index in (RESTITUTION, SLOPE, DRAG):
            moved = unknowns.copy()
            moved[index] += _SHORT if unknowns[index] < HIGH[index] - _SHORT else -_SHORT
            later_s = self.touches_s(moved, heard.numbers) - times_s
            slopes[index] = later_s / (moved[index] - unknowns[index])
        slopes[TOUCH] = heard.numbers.astype(np.float64)
        slopes[FALL] = times_s - unknowns[IMPACT] - slopes[TOUCH] * unknowns[TOUCH]
        slopes[IMPACT] = slopes[OFFSET] = np.ones(len(times_s))
        off_s = times_s + unknowns[OFFSET] - heard.times_s
        found = [
            Prior({OFFSET: 1.0}, float(unknowns[OFFSET]), OFFSET_SD_S),
            Prior({TOUCH: 1.0}, float(unknowns[TOUCH]) - TOUCH_S, TOUCH_SD_S),
        ]
        white = heard.whitening
        moves = {index: (white @ each).tolist() for index, each in slopes.items()}
        for at, off in enumerate((white @ off_s).tolist()):
            row = {index: each[at] for index, each in moves.items()}
            found.append(Prior(row, off, 1.0, HEARD_FREEDOM, measured=True))
        return found

    def _likely(self, unknowns: Array) -> list[Prior]:
        """Return the priors of balls, cameras and metres."""
        height_m = GRAVITY_M_S2 * float(np.exp(2 * unknowns[FALL])) / 2
        usual, sd_1_m = 0.0, DRAG_SD_1_M
        if self.drag_1_m is not None:
            usual, sd_1_m = self.drag_1_m, KNOWN_DRAG * self.drag_1_m
        found = [
            Prior({SLOPE: 1.0}, float(unknowns[SLOPE]), SLOPE_SD),
            Prior({DRAG: 1.0}, float(unknowns[DRAG] - usual * height_m), sd_1_m * height_m),
        ]
        if self.in_metres:
            off = float(np.log(unknowns[SPAN] / height_m))
            slopes = {SPAN: 1 / float(unknowns[SPAN]), FALL: -2.0}
            sd, freedom = (METRE_SD, METRE_FREEDOM) if self.scale_known else (ANY_SCALE_SD, np.inf)
            return [*found, Prior(slopes, off, sd, freedom)]
        found += [
            Prior({_KNOWN + bend: 1.0}, float(unknowns[_KNOWN + bend]), 1.0)
            for bend in range(len(self.bends_s))
        ]
        return [*found, Prior({PERSPECTIVE: 1.0}, float(unknowns[PERSPECTIVE]), PERSPECTIVE_SD)]
