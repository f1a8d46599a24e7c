"""Data that a payload's review draws: torques over the log's time."""

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

_MAX_JOINTS = 8  # that are drawn, those that feel the payload most: more would be too small to read
# Of one curve: more can neither be told apart nor be loaded soon.
_MAX_HZ, _MAX_SAMPLES = 120.0, 3000

_BOLD, _THIN = 1.6, 0.8  # widths of the result's curve and of the iterations before [points]


@dataclass(frozen=True, eq=False)
class TorqueCurve:
    """Simulated torques of all joints, and how they are drawn.

    Attributes:
        name: "k=3", "refined", "fit".
        label: The same with its mass, for a legend.
        color: Of the line.
        width: Of the line [points].
        mass_kg: That they were simulated with.
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
    """Torques of one tuning, and the motion that they drive.

    Attributes:
        arm: Without a payload.
        seconds: Since the log's first sample [s], shape (T,).
        position_rad: Of the joints [rad], shape (T, J).
        observed_nm: Torques with the joint's sign, the arm's weight included [N·m], shape (T, J).
        empty_nm: Of the model with an empty gripper [N·m], shape (T, J).
        felt_nm_per_kg: RMS torque per kilogram at each joint [N·m/kg], shape (J,).
        used: Joints whose torques count, shape (J,).
        order: Joints that are drawn; those that feel the payload most first.
        simulated: Torques of the rigid model, one per iteration; the last is the result.
        fitted: Torques with friction, offsets and all that the fit finds; None without a fit.
        fit: The fit itself; None without.
        com_m: Position of the payload in the tool frame [m].
        interval95: Of the mass [kg]; None if no valid one exists.
        has_estimate: Whether there is a mass to report.
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
        """Torques of the last iterate."""
        return self.simulated[-1]

    def title(self, joint: int, what: str = "") -> str:
        """Format a joint's number with the unit of its torque: "joint 2 [N·m]"."""
        unit = "N" if self.arm.joints[joint].is_prismatic else "N·m"
        return " ".join(filter(None, (f"joint {joint + 1}", what, f"[{unit}]")))


def payload_review_data(tuning: Tuning) -> PayloadReviewData:
    """Collect the data from a tuning that found an arm's motion."""
    found: PayloadDetection = tuning.detection
    seconds = found.path.seconds
    rate_hz = 1 / float(np.median(np.diff(seconds)))
    every = max(round(rate_hz / _MAX_HZ), -(-len(seconds) // _MAX_SAMPLES), 1)
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
        order=tuple(np.argsort(-felt, kind="stable")[:_MAX_JOINTS].tolist()),
        simulated=tuple(simulated),
        fitted=fitted,
        fit=fit,
        com_m=found.simulator.com_m,
        interval95=None if interval is None else (float(interval[0, 0]), float(interval[0, 1])),
        has_estimate=tuning.estimate is not None,
    )
