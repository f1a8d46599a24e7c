"""The observed and the simulated curve of a tuned drop, few enough samples for its JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.drop.detection import DropDetection
from analysis.estimators.base import Step
from analysis.tuning import Tuning
from tunenet_logs.arrays import Array

MOST_SAMPLES = 300
"""Of one curve in a JSON."""

_SHOWN_FALLS = 5.0
"""Fall times after the impact: little is to be seen later."""

_TIME_DECIMALS, _HEIGHT_DECIMALS = 5, 4
"""Of a time [s] and a height [m]: a tenth of a millimetre, and the time it takes to fall so far."""


@dataclass(frozen=True, eq=False)
class TunedCurves:
    """A recorded drop and the tuned simulator's, at the same times.

    Attributes:
        start_ns: the stamp that the seconds count from [ns].
        seconds: shape (T,), rising.
        observed_m: heights above the table [m], shape (T,).
        simulated_m: the same of the tuned simulator, shape (T,).
    """

    start_ns: int
    seconds: Array
    observed_m: Array
    simulated_m: Array

    def to_json(self) -> dict[str, Any]:
        """Rounded, for a tuning's JSON."""
        return {
            "start_ns": self.start_ns,
            "seconds": _rounded(self.seconds, _TIME_DECIMALS),
            "observed_m": _rounded(self.observed_m, _HEIGHT_DECIMALS),
            "simulated_m": _rounded(self.simulated_m, _HEIGHT_DECIMALS),
        }

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> TunedCurves:
        """What `to_json` wrote.

        Raises:
            ValueError, TypeError, LookupError: it is something else.
        """
        curves = [
            np.array(told[name], np.float64) for name in ("seconds", "observed_m", "simulated_m")
        ]
        seconds, observed, simulated = curves
        shapes = {one.shape for one in curves}
        if shapes != {(len(seconds),)} or not 2 <= len(seconds) <= MOST_SAMPLES:
            raise ValueError("its curves have other lengths")
        if not all(np.all(np.abs(one) < 1e6) for one in curves) or np.any(np.diff(seconds) <= 0):
            raise ValueError("its curves make no sense")
        return cls(int(told["start_ns"]), seconds, observed, simulated)


def tuned_curves(tuning: Tuning) -> TunedCurves | None:
    """The curves of a tuning; None where it found no drop."""
    found = tuning.found
    if not isinstance(found, DropDetection) or tuning.trace is None:
        return None
    drop = found.drop
    simulated_s, simulated_m = simulated_heights(tuning, tuning.trace.steps[-1])
    if not len(simulated_s):
        return None
    shown = drop.impact_s + _SHOWN_FALLS * drop.fall_time_s
    begin = drop.release_s - 0.25 * drop.fall_time_s
    heights = observed_heights_m(tuning)
    inside = (drop.seconds >= begin) & (drop.seconds <= shown) & np.isfinite(heights)
    seconds, observed = drop.seconds[inside], heights[inside]
    if len(seconds) < 2:
        return None
    if len(seconds) > MOST_SAMPLES:
        even = np.linspace(seconds[0], seconds[-1], MOST_SAMPLES)
        seconds, observed = even, np.interp(even, seconds, observed)
    simulated = np.interp(seconds, simulated_s, simulated_m)
    return TunedCurves(int(found.start_ns), seconds, observed, simulated)


def observed_heights_m(tuning: Tuning) -> Array:
    """Heights of a drop above the table [m], at the drop's own times, shape (T,)."""
    drop = tuning.found.drop
    return drop.heights_m - (drop.contact_m if tuning.physical else drop.table_m)


def simulated_heights(tuning: Tuning, step: Step) -> tuple[Array, Array]:
    """Times on the log's clock [s] and heights above the table [m] of one iterate, each (T,)."""
    assert step.evaluation is not None
    found, episode = tuning.found, step.evaluation.episode
    signal = next(iter(episode.signals.values()))
    seconds = (signal.stamps_ns - found.start_ns) * 1e-9
    heights = signal.values[:, 2] - episode.info.rig["ball_diameter_m"] / 2
    first, last = found.drop.seconds[0], found.drop.seconds[-1]
    inside = (seconds > first - 1e-6) & (seconds < last + 1e-6)
    return seconds[inside], heights[inside]


def _rounded(values: Array, decimals: int) -> list[float]:
    return np.round(values, decimals).tolist()
