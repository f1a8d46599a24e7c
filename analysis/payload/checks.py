"""Checks of a fitted payload: whether an arm is behind the torques, and how sure the mass is."""

from __future__ import annotations

import numpy as np

from analysis.drop.checks import Check
from analysis.payload.arm_log import ArmLog
from analysis.payload.fit_result import Left, PayloadFit
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array

_MOST_LEFT_NM, _REJECT_LEFT_NM = 1.0, 2.5
_MOST_SIMULATED_NM = 1.5
_REJECT_SHARE = 0.5
_LIVELY_NM = 1.0
"""Spread of torques from which on their explained share tells anything."""
_SURE_ODDS = 5.0
_MOST_LAG_S = 0.1
_USUAL_SDS = 5.0
_SURE_KG, _SURE_SHARE = 0.15, 0.1
_REJECT_KG = 2.0
_BELOW_SDS = 4.0
_LEFT_ALONE = 0.95
_ARM_ADVICE = (
    "check that torques and positions are of the same joints, in N·m, and the arm (--urdf: an arm "
    "that does not stand upright needs its tilt in the base joint)"
)


def payload_checks(fit: PayloadFit, arm: Arm, log: ArmLog) -> list[Check]:
    """What speaks for and against the mass."""
    names = {(1, True): "the joints' torques, with gravity"}
    names[-1, True] = "torques with the sign opposite to the joints', with gravity"
    names[1, False] = "the joints' torques, without the arm's gravity"
    names[-1, False] = "torques with the sign opposite to the joints', without the arm's gravity"
    meant = names[fit.convention.sign, fit.convention.has_gravity]
    return [
        *_tare_checks(fit),
        _arm_check("torques fit the arm", fit.left, fit.arm_odds, _ARM_ADVICE),
        Check(
            "sign and gravity",
            fit.convention_odds > _SURE_ODDS,
            f"{meant} (log evidence {fit.convention_odds:.0f} over the next; wanted: "
            f"{_SURE_ODDS:.0f} or more)",
            advice="move the payload far out to the side, so that its weight shows",
        ),
        Check(
            "lag",
            abs(fit.lag_s) < _MOST_LAG_S,
            f"torques are {1000 * fit.lag_s:.0f} ms behind the positions (at most "
            f"{1000 * _MOST_LAG_S:.0f} either way)",
            advice="stamp positions and torques with one clock, when they are measured",
        ),
        _usual_check(fit),
        _lift_check(fit, arm, log),
        Check(
            "payload in the tool frame",
            fit.centre.is_told or fit.off_centre < _LEFT_ALONE,
            f"probability that its centre of mass is elsewhere {fit.off_centre:.2f} (at most "
            f"{_LEFT_ALONE}, where the log does not tell it): {fit.told_apart}",
            advice=_remedy(fit, "turn the hand by 90° about two axes in the motion"),
        ),
    ]


def _remedy(fit: PayloadFit, motion: str) -> str:
    """What tells more: a tare where there is none, then another motion."""
    return motion if fit.has_tare else "record the empty gripper too and give it with --tare"


def sure_check(fit: PayloadFit) -> Check:
    """Whether the interval is narrow enough to be of use."""
    low, high = fit.interval95
    half = (high - low) / 2
    most_kg = max(_SURE_KG, _SURE_SHARE * fit.mass_kg)
    return Check(
        "sure enough",
        half < most_kg,
        f"95 % interval of ±{half:.3f} kg (at most {most_kg:.2f})",
        fatal=half > _REJECT_KG,
        advice=_remedy(fit, "record longer, the payload far out to the side, the hand turning"),
    )


def simulation_check(left_nm: Array) -> Check:
    """Whether the simulated arm needs the torques that were measured, all but what is no mass's.

    Args:
        left_nm: measured less simulated, shape (T, J).
    """
    rms = float(np.sqrt(np.mean(left_nm**2)))
    return Check(
        "simulation fits",
        rms < _MOST_SIMULATED_NM,
        f"{rms:.2f} N·m between measured and simulated torques, rms, friction and offsets "
        f"included (at most {_MOST_SIMULATED_NM:g})",
        advice="use the preset default, or check the arm (--urdf)",
    )


def _tare_checks(fit: PayloadFit) -> list[Check]:
    """Whether an arm is behind the empty run: before the log is blamed for it."""
    if fit.tare_left is None:
        return []
    name, advice = "tare: torques fit the arm", f"record the tare anew, and {_ARM_ADVICE}"
    return [_arm_check(name, fit.tare_left, 0.0, advice)]


def _arm_check(name: str, left: Left, arm_odds: float, advice: str) -> Check:
    """Whether any arm is behind these torques."""
    rms, spread = left.rms_nm, left.spread_nm
    lost = rms > _REJECT_LEFT_NM or arm_odds < 0
    lost |= spread > _LIVELY_NM and left.share > _REJECT_SHARE
    detail = (
        f"{rms:.2f} N·m are left, rms (at most {_MOST_LEFT_NM:.0f}); torques change by "
        f"{spread:.2f} N·m"
    )
    if lost:
        detail = f"these torques fit no arm, whatever their sign and gravity: {detail}"
    return Check(name, rms < _MOST_LEFT_NM and not lost, detail, fatal=lost, advice=advice)


def _usual_check(fit: PayloadFit) -> Check:
    """Whether friction, offsets and the like are as large as such terms are."""
    worst = max(fit.nuisances, key=lambda one: abs(one.value) / one.prior_sd)
    sds = abs(worst.value) / worst.prior_sd
    return Check(
        "friction and sensors are usual",
        sds < _USUAL_SDS,
        f"{worst.name} is {worst.value:+.3g}, {sds:.1f} times what is usual (at most "
        f"{_USUAL_SDS:.0f})",
        advice="set the torque sensors to zero in the candle pose, and check the arm (--urdf)",
    )


def _lift_check(fit: PayloadFit, arm: Arm, log: ArmLog) -> Check:
    """A mass that the arm can hold."""
    limits = np.array([one.max_effort_nm for one in arm.joints])
    shares = np.quantile(np.abs(log.effort.values), 0.99, axis=0) / limits
    worst = int(np.argmax(shares))
    below = -fit.signed_kg / fit.sd_kg
    zero = "that the tare's gripper was empty" if fit.has_tare else "its zero with a --tare"
    return Check(
        "within what the arm lifts",
        float(shares[worst]) < 1 and below < _BELOW_SDS,
        f"{fit.signed_kg:.3f} kg (0 or more); {arm.joints[worst].name} at "
        f"{100 * shares[worst]:.0f} % of its highest torque",
        advice=f"check the arm's model (--urdf), and {zero}",
    )
