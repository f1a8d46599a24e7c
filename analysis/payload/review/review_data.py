"""What a payload's review draws, taken from a tuning once: torques over the log's time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.payload.detection import EFFORT, PayloadDetection
from analysis.payload.fit_result import PayloadFit
from analysis.record import Tuning
from analysis.review.drawing import FITTED, Color, ramp
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array

_MOST_JOINTS = 8
"""That are drawn, those that feel the payload most: more would be too small to read."""

_MOST_HZ, _MOST_SAMPLES = 120.0, 3000
"""Of one curve: more can neither be told apart nor be loaded soon."""

_BOLD, _THIN = 1.6, 0.8
"""Widths of the result's curve and of the iterations before [points]."""


@dataclass(frozen=True, eq=False)
class TorqueCurve:
    """Simulated torques of all joints, and how they are drawn.

    Attributes:
        name: "k=3", "refined", "fit".
        label: the same with its mass, for a legend.
        color: of the line.
        width: of the line [points].
        mass_kg: that they were simulated with.
        effort_nm: [N·m], shape (T, J).
    """

    name: str
    label: str
    color: Color
    width: float
    mass_kg: float
    effort_nm: Array


@dataclass(frozen=True, eq=False)
class PayloadReviewData:
    """The torques of one tuning, and the motion that they drive.

    Attributes:
        arm: as it is without a payload.
        seconds: since the log's first sample [s], shape (T,).
        position_rad: of the joints [rad], shape (T, J).
        observed_nm: torques with the joint's sign and the arm's weight in them [N·m], shape (T, J).
        empty_nm: of the model with nothing in its gripper [N·m], shape (T, J).
        felt_nm_per_kg: what a kilogram does to each joint (rms) [N·m/kg], shape (J,).
        used: joints whose torques count, shape (J,).
        order: joints that are drawn; those that feel the payload most first.
        simulated: torques of the rigid model, one an iteration; the last is the result.
        fitted: torques with friction, offsets and all that the fit finds; None without a fit.
        fit: the fit itself; None without.
        com_m: where the payload is, in the tool frame [m].
        interval95: of the mass [kg]; None where none is honest.
        has_estimate: whether there is a mass to report.
    """

    arm: Arm
    seconds: Array
    position_rad: Array
    observed_nm: Array
    empty_nm: Array
    felt_nm_per_kg: Array
    used: NDArray[np.bool_]
    order: tuple[int, ...]
    simulated: tuple[TorqueCurve, ...]
    fitted: TorqueCurve | None
    fit: PayloadFit | None
    com_m: tuple[float, float, float]
    interval95: tuple[float, float] | None
    has_estimate: bool

    @property
    def result(self) -> TorqueCurve:
        """The last iterate."""
        return self.simulated[-1]

    def title(self, joint: int, what: str = "") -> str:
        """A joint by its number, with the unit of its torque: "joint 2 [N·m]"."""
        unit = "N" if self.arm.joints[joint].is_prismatic else "N·m"
        return " ".join(filter(None, (f"joint {joint + 1}", what, f"[{unit}]")))


def payload_review_data(tuning: Tuning) -> PayloadReviewData:
    """From a tuning that found an arm's motion."""
    found: PayloadDetection = tuning.detection
    seconds = found.path.seconds
    rate_hz = 1 / float(np.median(np.diff(seconds)))
    every = max(round(rate_hz / _MOST_HZ), -(-len(seconds) // _MOST_SAMPLES), 1)
    kept = slice(None, None, every)
    felt = np.sqrt(np.mean(found.simulator.efforts_nm_per_kg**2, axis=0))
    fit = tuning.trace.fit.detail if tuning.trace and tuning.trace.fit else None
    fitted = None
    if fit is not None:
        # As the observed torques are drawn: with the arm's weight in them.
        effort_nm = (fit.predicted_nm + found.effort_nm - fit.effort_nm)[kept]
        label = "fit, with friction"
        fitted = TorqueCurve("fit", label, FITTED, _BOLD, fit.held.mass_kg, effort_nm)
    steps = tuning.trace.steps if tuning.trace else ()
    simulated: list[TorqueCurve] = []
    for k, step in enumerate(steps):
        assert step.evaluation is not None
        is_last = k == len(steps) - 1
        name = "refined" if is_last and fit is not None else f"k={k}"
        mass_kg = float(step.values[0])
        simulated.append(
            TorqueCurve(
                name=name,
                label=f"{name}  {mass_kg:.4f} kg",
                color=ramp(k, len(steps)),
                width=_BOLD if is_last else _THIN,
                mass_kg=mass_kg,
                effort_nm=step.evaluation.episode.signals[EFFORT].values[kept],
            )
        )
    interval = tuning.interval95
    return PayloadReviewData(
        arm=found.arm,
        seconds=seconds[kept],
        position_rad=found.path.position_rad[kept],
        observed_nm=found.effort_nm[kept],
        empty_nm=found.simulator.empty_efforts_nm[kept],
        felt_nm_per_kg=felt,
        used=found.fit.used,
        order=tuple(np.argsort(-felt, kind="stable")[:_MOST_JOINTS].tolist()),
        simulated=tuple(simulated),
        fitted=fitted,
        fit=fit,
        com_m=found.simulator.com_m,
        interval95=None if interval is None else (float(interval[0, 0]), float(interval[0, 1])),
        has_estimate=tuning.estimate is not None,
    )
