"""What a drop's review shows, taken from its tuning once: curves over the log's time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.record_parts import observed_heights_m, simulated_heights
from analysis.record import Rebound, Tuning, record_of
from analysis.review.drawing import OBSERVED, Color, ramp
from recorders.simulators.closed_form.bounce import Bounce
from tunenet_logs.arrays import Array

_SOFTEST = 0.1
"""Of the first rebound's speed: slower impacts are of hops that look like rest (1 % as high)."""

_SHOWN_FALLS = 5
"""Fall times after the first impact: a ball of restitution 0.7 lies still by then."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A height over the log's time.

    Attributes:
        name: "observed", "k=3", "refined".
        label: the same with its value, for a legend.
        color: of its line, its ball and its label.
        width: of its line, in points of the screen.
        value: the restitution it was simulated with; NaN for the observed one.
        seconds: since the log's first sample [s], shape (T,).
        heights_m: above the table, of a residual above the observed height [m], shape (T,).
    """

    name: str
    label: str
    color: Color
    width: float
    value: float
    seconds: Array
    heights_m: Array


@dataclass(frozen=True, eq=False)
class ReviewData:
    """The curves of one tuning.

    Attributes:
        observed: the recorded heights.
        simulated: one an iteration, cut to the observed span; the last is the result.
        residuals: of each simulated curve, less the observed one at the observed times.
        drop_height_m: what the views are scaled by.
        release_s: when the ball was let go, on the log's time.
        impact_s: the first impact.
        end_s: when little more is to be seen.
        impacts_s: of the result's ball, on the log's time, those that are apart; shape (I,) [s].
        bounces: what is known of each impact of its own; empty if nothing tells them apart.
        interval95: of the result; None where none is honest.
    """

    observed: Curve
    simulated: tuple[Curve, ...]
    residuals: tuple[Curve, ...]
    drop_height_m: float
    release_s: float
    impact_s: float
    end_s: float
    impacts_s: Array
    bounces: tuple[Rebound, ...] = ()
    interval95: tuple[float, float] | None = None


def review_data(tuning: Tuning) -> ReviewData:
    """What the review of a tuning shows that found a drop."""
    drop = tuning.detection.drop
    steps = tuning.trace.steps if tuning.trace else ()
    fit = tuning.trace.fit if tuning.trace else None
    heights = observed_heights_m(tuning.detection)
    observed = Curve("observed", "observed", OBSERVED, 2.5, float("nan"), drop.seconds, heights)
    simulated: list[Curve] = []
    residuals: list[Curve] = []
    for k, step in enumerate(steps):
        seconds, heights = simulated_heights(tuning.detection, step)
        value = float(step.values[0])
        width = 3.0 if k == len(steps) - 1 else 1.2
        is_refined = fit is not None and k == len(steps) - 1
        name = "refined" if is_refined else f"k={k}"
        label = f"{name}  e={value:.4f}"
        color = ramp(k, len(steps))
        curve = Curve(name, label, color, width, value, seconds, heights)
        simulated.append(curve)
        off = np.interp(observed.seconds, seconds, heights) - observed.heights_m
        residuals.append(replace(curve, seconds=observed.seconds, heights_m=off))
    # Impacts that were found, else an ideal ball's; the first alone where no ball is simulated.
    impacts = [rebound.impact_s for rebound in fit.detail] if fit else []
    if len(impacts) < 2 and tuning.trace is not None and tuning.physical:
        ball = Bounce(float(tuning.trace.estimate[0]))
        starts, speeds = ball.flights((drop.seconds[-1] - drop.impact_s) / drop.fall_time_s)
        hard = speeds > _SOFTEST * ball.restitution
        hard[0] = True
        impacts = list(drop.impact_s + drop.fall_time_s * starts[hard])
    impacts_s = np.array(impacts or [drop.impact_s], dtype=np.float64)
    interval95 = None
    if tuning.interval95 is not None:
        low, high = tuning.interval95[0]
        interval95 = float(low), float(high)
    return ReviewData(
        observed=observed,
        simulated=tuple(simulated),
        residuals=tuple(residuals),
        drop_height_m=float(drop.drop_height_m),
        release_s=float(drop.release_s),
        impact_s=float(drop.impact_s),
        end_s=float(min(drop.seconds[-1], drop.impact_s + _SHOWN_FALLS * drop.fall_time_s)),
        impacts_s=impacts_s[impacts_s <= drop.seconds[-1]],
        bounces=record_of(tuning).rebounds if fit and fit.detail else (),
        interval95=interval95,
    )
