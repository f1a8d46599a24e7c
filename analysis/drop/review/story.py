"""What a review tells, taken from a tuning once: curves over the log's time, one an iteration."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.bounces import ReportedBounce, bounces_of
from analysis.drop.curves import observed_heights_m, simulated_heights
from analysis.review.colors import OBSERVED, Color, ramp
from analysis.tuning import Tuning
from recorders.simulators.bounce import Bounce
from tunenet_logs.arrays import Array

_SOFTEST = 0.1
"""Of the first rebound's speed: smaller hops look like rest."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A height above the table over the log's time.

    Attributes:
        name: "observed", "k=3", "refined".
        label: the same with its value, for a legend.
        value: the restitution it was simulated with; NaN for the observed one.
        seconds: since the log's first sample [s], shape (T,).
        heights_m: shape (T,).
    """

    name: str
    label: str
    color: Color
    width: float
    value: float
    seconds: Array
    heights_m: Array

    def minus(self, other: Curve) -> Curve:
        """This curve less `other`, at the other's times."""
        off = np.interp(other.seconds, self.seconds, self.heights_m) - other.heights_m
        return replace(self, seconds=other.seconds, heights_m=off)


@dataclass(frozen=True, eq=False)
class ReviewData:
    """The curves of one tuning.

    Attributes:
        simulated: one an iteration, cut to the observed span; the last is the result.
        drop_height_m: what the views are scaled by.
        release_s: when the ball was let go, on the log's time.
        impact_s: the first impact.
        end_s: when little more is to be seen.
        impacts_s: of the result's ball, on the log's time: those that can be told apart.
        bounces: what is known of each impact of its own; none where nothing tells them apart.
        interval95: of the result; None where none is honest.
    """

    observed: Curve
    simulated: tuple[Curve, ...]
    drop_height_m: float
    release_s: float
    impact_s: float
    end_s: float
    impacts_s: Array
    bounces: tuple[ReportedBounce, ...] = ()
    interval95: tuple[float, float] | None = None


def review_data(tuning: Tuning) -> ReviewData:
    """The story of a tuning that found a drop."""
    drop = tuning.found.drop
    steps = tuning.trace.steps if tuning.trace else ()
    heights = observed_heights_m(tuning)
    observed = Curve("observed", "observed", OBSERVED, 2.5, float("nan"), drop.seconds, heights)
    simulated: list[Curve] = []
    for k, step in enumerate(steps):
        seconds, heights = simulated_heights(tuning, step)
        value = float(step.values[0])
        width = 3.0 if k == len(steps) - 1 else 1.2
        is_refined = tuning.refined is not None and k == len(steps) - 1
        name = "refined" if is_refined else f"k={k}"
        label = f"{name}  e={value:.4f}"
        color = ramp(k, len(steps))
        simulated.append(Curve(name, label, color, width, value, seconds, heights))
    return ReviewData(
        observed=observed,
        simulated=tuple(simulated),
        drop_height_m=float(drop.drop_height_m),
        release_s=float(drop.release_s),
        impact_s=float(drop.impact_s),
        end_s=float(min(drop.seconds[-1], drop.impact_s + 5 * drop.fall_time_s)),
        impacts_s=_impacts(tuning),
        bounces=bounces_of(tuning) if tuning.refined and tuning.refined.rebounds else (),
        interval95=_interval(tuning),
    )


def _interval(tuning: Tuning) -> tuple[float, float] | None:
    if tuning.interval95 is None:
        return None
    low, high = (float(end) for end in tuning.interval95[0])
    return low, high


def _impacts(tuning: Tuning) -> Array:
    """Those that were found each, else those of an ideal ball; the first alone if it is not one."""
    drop, last_s = tuning.found.drop, float(tuning.found.drop.seconds[-1])
    found = [one.impact_s for one in tuning.refined.rebounds] if tuning.refined else []
    if len(found) < 2 and tuning.trace is not None and tuning.physical:
        ball = Bounce(float(tuning.trace.estimate[0]))
        starts, speeds = ball.flights((last_s - drop.impact_s) / drop.fall_time_s)
        hard = speeds > _SOFTEST * ball.restitution
        hard[0] = True
        found = list(drop.impact_s + drop.fall_time_s * starts[hard])
    impacts = np.array(found or [drop.impact_s], dtype=np.float64)
    return impacts[impacts <= last_s]
