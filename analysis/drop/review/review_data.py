"""Review data of a drop, taken from its tuning once: curves over the log's time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounce_model import DRAG, RESTITUTION, SLOPE
from analysis.drop.detection import AnyDetection
from analysis.drop.motion import last_bounce_s, matched, simulated_m
from analysis.estimators.base import Step
from analysis.record import Rebound, Tuning, record_of
from analysis.review.drawing import OBSERVED, Color, ramp
from recorders.simulators.base import GRAVITY_M_S2
from recorders.simulators.closed_form.bounce import Bounce
from tunenet_logs.arrays import Array

# Of the first rebound's speed: slower impacts are of hops that look like rest (1 % as high).
_SOFTEST = 0.1

_SAME_S = 1e-6  # stamps that differ by less are of one moment
_SHOWN_FALLS = 5  # fall times after the first impact: a ball of restitution 0.7 lies still by then
# Fall times before the release that are shown (a review opens there, and should not begin with a
# ball that is held), and after the last bounce in view that the chart of heights opens with.
_BEFORE_FALLS, _AFTER_FALLS = 0.25, 0.5

# Of parameters, as a legend has room for them.
_SYMBOLS = {"restitution": "e", "restitution_slope": "p", "drag": "k"}


@dataclass(frozen=True, eq=False)
class Curve:
    """Height over the log's time.

    Attributes:
        name: "observed", "k=3", "refined".
        label: the same with its values, for a legend.
        color: of its line, its ball and its label.
        width: of its line, in points of the screen.
        values: it was simulated with, by parameter; none for the observed one.
        seconds: since the log's first sample [s], shape (T,).
        heights_m: above the table, of a residual above the observed height [m], shape (T,).
    """

    name: str
    label: str
    color: Color
    width: float
    values: Mapping[str, float]
    seconds: Array
    heights_m: Array


@dataclass(frozen=True)
class TunedBall:
    """Tuned ball in closed form, between the samples too.

    Attributes:
        bounce: the ball, with its own air.
        impact_s: its first impact, on the log's time.
        fall_time_s: of a fall from the same height without air.
    """

    bounce: Bounce
    impact_s: float
    fall_time_s: float

    def heights(self, seconds: Array) -> Array:
        """Return heights above contact at times on the log's clock, shape (T,) [drop heights]."""
        return self.bounce.heights((seconds - self.impact_s) / self.fall_time_s)

    def impacts_s(self, until_s: float) -> Array:
        """Return impacts on the log's clock, of hops that do not look like rest, shape (I,) [s]."""
        starts, speeds = self.bounce.flights((until_s - self.impact_s) / self.fall_time_s)
        hard = speeds > _SOFTEST * speeds[0]
        hard[0] = True
        found = self.impact_s + self.fall_time_s * starts[hard]
        return found[found <= until_s]


@dataclass(frozen=True, eq=False)
class ReviewData:
    """Curves of one tuning.

    Attributes:
        observed: the recorded heights.
        simulated: one an iteration, at the observation's own stamps; the last is the result.
        residuals: of each simulated curve, less the observed one at the observed times.
        drop_height_m: what the views are scaled by.
        release_s: when the ball was let go, on the log's time.
        impact_s: the first impact.
        end_s: when little more is to be seen.
        seen_s: when the last bounce that counts ends, and a little.
        impacts_s: of the result's ball, on the log's time, those that are apart; shape (I,) [s].
        ball: the result's; None where no ball was fitted, as with the paper's simulator.
        bounces: each impact's own restitution; empty if they cannot be determined.
        interval95: of the result; None where none is honest.
    """

    observed: Curve
    simulated: tuple[Curve, ...]
    residuals: tuple[Curve, ...]
    drop_height_m: float
    release_s: float
    impact_s: float
    end_s: float
    seen_s: float
    impacts_s: Array
    ball: TunedBall | None = None
    bounces: tuple[Rebound, ...] = ()
    interval95: tuple[float, float] | None = None

    @property
    def shown_s(self) -> tuple[float, float]:
        """First and last moment of the plots, on the log's time."""
        return float(self.observed.seconds[0]), self.seen_s


def review_data(tuning: Tuning) -> ReviewData:
    """Collect the review of a tuning that found a drop."""
    detection: AnyDetection = tuning.detection
    drop = detection.drop
    steps = tuning.trace.steps if tuning.trace else ()
    fit = tuning.trace.fit if tuning.trace else None
    observed = _observed(detection)
    curves = tuple(_simulated(tuning, k) for k in range(len(steps)))
    residuals = tuple(_residual(curve, observed) for curve in curves)
    ball = _ball(detection, steps[-1]) if steps else None
    last_s = float(observed.seconds[-1])
    impacts_s = np.array([drop.impact_s]) if ball is None else ball.impacts_s(last_s)
    interval95 = None
    if tuning.interval95 is not None:
        low, high = tuning.interval95[0]
        interval95 = float(low), float(high)
    return ReviewData(
        observed=observed,
        simulated=curves,
        residuals=residuals,
        drop_height_m=float(drop.drop_height_m),
        release_s=float(drop.release_s),
        impact_s=float(drop.impact_s),
        end_s=float(min(last_s, drop.impact_s + _SHOWN_FALLS * drop.fall_time_s)),
        seen_s=_seen_s(detection, last_s),
        impacts_s=impacts_s,
        ball=ball,
        bounces=record_of(tuning).rebounds if fit and fit.detail else (),
        interval95=interval95,
    )


def _observed(detection: AnyDetection) -> Curve:
    """Return the samples' heights by the fitted camera, or the fitted table."""
    drop = detection.drop
    posterior = detection.posterior if detection.physical else None
    if posterior is None:
        seconds = drop.seconds
        heights_m = drop.heights_m - (drop.contact_m if detection.physical else drop.table_m)
    else:
        seconds = detection.observed.seconds
        view = posterior.fit.projection()
        heights = view.heights(detection.observed.positions, seconds)
        heights_m = heights * drop.drop_height_m
    shown = seconds >= begin_s(detection)
    return Curve("observed", "observed", OBSERVED, 2.5, {}, seconds[shown], heights_m[shown])


def begin_s(detection: AnyDetection) -> float:
    """Return when the plots of a drop begin, on the log's clock [s]."""
    drop = detection.drop
    return float(drop.release_s - _BEFORE_FALLS * drop.fall_time_s)


def _simulated(tuning: Tuning, k: int) -> Curve:
    """Return the rollout of iterate `k`, as long as something is observed."""
    assert tuning.trace is not None
    detection, steps = tuning.detection, tuning.trace.steps
    first_s, last_s = _observed(detection).seconds[[0, -1]]
    seconds, heights_m = simulated_m(detection, steps[k])
    inside = (seconds > first_s - _SAME_S) & (seconds < last_s + _SAME_S)
    is_last = k == len(steps) - 1
    name = "refined" if tuning.trace.fit is not None and is_last else f"k={k}"
    names = [parameter.name for parameter in tuning.parameters]
    values = dict(zip(names, steps[k].values.tolist(), strict=True))
    return Curve(
        name=name,
        label=f"{name}  {values_words(values)}",
        color=ramp(k, len(steps)),
        width=3.0 if is_last else 1.2,
        values=values,
        seconds=seconds[inside],
        heights_m=heights_m[inside],
    )


def values_words(values: Mapping[str, float]) -> str:
    """Format parameters as a legend has room for them: "e=.752 p=.03 k=.11/m"."""
    alone = len(values) == 1
    parts: list[str] = []
    for name, value in values.items():
        digits = 4 if alone else 3
        number = f"{round(value, digits) + 0.0:.{digits}f}"  # no -0
        number = number if alone else number.replace("0.", ".", 1)
        unit = "/m" if name == "drag" else ""
        parts.append(f"{_SYMBOLS.get(name, name)}={number}{unit}")
    return " ".join(parts)


def _residual(curve: Curve, observed: Curve) -> Curve:
    """Subtract sample by sample where both have the same stamps, as all but the paper's do."""
    at, rows = matched(observed.seconds, curve.seconds)
    if len(at) > 1:
        off = curve.heights_m[rows] - observed.heights_m[at]
        return replace(curve, seconds=observed.seconds[at], heights_m=off)
    off = np.interp(observed.seconds, curve.seconds, curve.heights_m) - observed.heights_m
    return replace(curve, seconds=observed.seconds, heights_m=off)


def _ball(detection: AnyDetection, last: Step) -> TunedBall | None:
    """Return the ball of an iterate, let go where and when its rollout was."""
    posterior = detection.posterior if detection.physical else None
    if posterior is None:
        return None
    drop, fit = detection.drop, posterior.fit
    height_m = GRAVITY_M_S2 * drop.fall_time_s**2 / 2
    restitution, slope, drag_1_m = (*last.values.tolist(), 0.0, 0.0)[:3]
    unknowns = fit.unknowns.copy()
    unknowns[[RESTITUTION, SLOPE, DRAG]] = restitution, slope, drag_1_m * height_m
    bounce = fit.samples.bounce(unknowns)
    impact_s = drop.release_s + drop.fall_time_s * bounce.fall_time
    if bounce.flies_in:  # its release is where it is first seen
        impact_s = drop.impact_s
    return TunedBall(bounce, float(impact_s), float(drop.fall_time_s))


def _seen_s(detection: AnyDetection, last_s: float) -> float:
    """Return when the last bounce in view ends, and half a fall time later."""
    drop = detection.drop
    posterior = detection.posterior if detection.physical else None
    if posterior is None:
        return last_s
    noise = drop.noise_m / drop.drop_height_m
    seen_s = last_bounce_s(posterior.fit.projection(), last_s, noise)
    return float(min(last_s, seen_s + _AFTER_FALLS * drop.fall_time_s))
