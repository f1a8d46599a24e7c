"""What a payload's review tells, taken from a tuning once: torques over the log's time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.payload.detection import EFFORT, PayloadDetection
from analysis.payload.fit_result import PayloadFit
from analysis.review.colors import FITTED, Color, ramp
from analysis.review.iterates import Iterates, span_of
from analysis.tuning import Tuning
from recorders.simulators.arm.description import Arm
from recorders.simulators.arm.payload import PAYLOAD_MASS
from tunenet_logs.arrays import Array

MOST_JOINTS = 8
"""That are drawn: those that feel the payload most."""

_MOST_HZ, _MOST_SAMPLES = 120.0, 3000
"""Of one curve: more can neither be told apart nor be loaded soon."""

_LEAST_SPAN_KG = 0.02


@dataclass(frozen=True, eq=False)
class Torques:
    """Simulated torques of all joints.

    Attributes:
        name: "k=3", "refined", "fit".
        label: the same with its mass, for a legend.
        mass_kg: that they were simulated with.
        effort_nm: shape (T, J).
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
        position_rad: of the joints, shape (T, J).
        observed_nm: torques with the joint's sign and the arm's weight in them, shape (T, J).
        empty_nm: of the model with nothing in its gripper, shape (T, J).
        felt_nm_per_kg: what a kilogram does to each joint (rms), shape (J,).
        used: joints whose torques count, shape (J,).
        order: joints that are drawn; those that feel the payload most first.
        simulated: torques of the rigid model, one an iteration; the last is the result.
        fitted: torques with friction, offsets and all that the fit finds; None without a fit.
        fit: the fit itself; None without.
        com_m: where the payload is, in the tool frame.
        interval95: of the mass; None where none is honest.
        is_told: whether there is a mass to report.
    """

    arm: Arm
    seconds: Array
    position_rad: Array
    observed_nm: Array
    empty_nm: Array
    felt_nm_per_kg: Array
    used: NDArray[np.bool_]
    order: tuple[int, ...]
    simulated: tuple[Torques, ...]
    fitted: Torques | None
    fit: PayloadFit | None
    com_m: tuple[float, float, float]
    interval95: tuple[float, float] | None
    is_told: bool

    @property
    def rate_hz(self) -> float:
        """Of the samples that are drawn."""
        return 1 / float(np.median(np.diff(self.seconds)))

    @property
    def result(self) -> Torques:
        """The last iterate."""
        return self.simulated[-1]

    def title(self, joint: int, what: str = "") -> str:
        """A joint by its number, with the unit of its torque: "joint 2 [N·m]"."""
        unit = "N" if self.arm.joints[joint].is_prismatic else "N·m"
        return " ".join(filter(None, (f"joint {joint + 1}", what, f"[{unit}]")))

    def iterates(self) -> Iterates:
        """The mass by iteration."""
        values = [one.mass_kg for one in self.simulated]
        return Iterates(
            parameter="mass",
            unit=PAYLOAD_MASS.unit,
            names=tuple(one.name for one in self.simulated),
            values=tuple(values),
            colors=tuple(one.color for one in self.simulated),
            span=span_of([*values, *(self.interval95 or ())], _LEAST_SPAN_KG),
            interval95=self.interval95,
        )


def payload_review_data(tuning: Tuning) -> PayloadReviewData:
    """The story of a tuning that found an arm's motion."""
    found: PayloadDetection = tuning.found
    kept = _kept(found.path.seconds)
    felt = np.sqrt(np.mean(found.simulator.efforts_nm_per_kg**2, axis=0))
    fit = None if tuning.refined is None else tuning.refined.fit
    interval = tuning.interval95
    return PayloadReviewData(
        arm=found.arm,
        seconds=found.path.seconds[kept],
        position_rad=found.path.position_rad[kept],
        observed_nm=found.effort_nm[kept],
        empty_nm=found.simulator.empty_efforts_nm[kept],
        felt_nm_per_kg=felt,
        used=found.fit.used,
        order=tuple(np.argsort(-felt, kind="stable")[:MOST_JOINTS].tolist()),
        simulated=_simulated(tuning, kept),
        fitted=None if fit is None else _fitted(found, fit, kept),
        fit=fit,
        com_m=found.simulator.com_m,
        interval95=None if interval is None else (float(interval[0, 0]), float(interval[0, 1])),
        is_told=tuning.estimate is not None,
    )


def _kept(seconds: Array) -> slice:
    """Which samples are drawn."""
    rate_hz = 1 / float(np.median(np.diff(seconds)))
    return slice(None, None, max(round(rate_hz / _MOST_HZ), -(-len(seconds) // _MOST_SAMPLES), 1))


def _simulated(tuning: Tuning, kept: slice) -> tuple[Torques, ...]:
    steps = tuning.trace.steps if tuning.trace else ()
    curves: list[Torques] = []
    for k, step in enumerate(steps):
        assert step.evaluation is not None
        is_last = k == len(steps) - 1
        name = "refined" if is_last and tuning.refined is not None else f"k={k}"
        mass_kg = float(step.values[0])
        curves.append(
            Torques(
                name=name,
                label=f"{name}  {mass_kg:.4f} kg",
                color=ramp(k, len(steps)),
                width=1.6 if is_last else 0.8,
                mass_kg=mass_kg,
                effort_nm=step.evaluation.episode.signals[EFFORT].values[kept],
            )
        )
    return tuple(curves)


def _fitted(found: PayloadDetection, fit: PayloadFit, kept: slice) -> Torques:
    """The fit's torques as the observed ones are drawn: with the arm's weight in them."""
    effort_nm = (fit.predicted_nm + found.effort_nm - fit.effort_nm)[kept]
    return Torques("fit", "fit, friction and offsets too", FITTED, 1.6, fit.mass_kg, effort_nm)
