"""Checks of a payload: the log, whether an arm explains the torques, precision of the mass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from tunenet_logs.analysis.checks import Check
from tunenet_logs.analysis.payload.arm_log import ArmLog
from tunenet_logs.analysis.payload.torque_fit import FitResidual, PayloadFit
from tunenet_logs.analysis.payload.torque_model import ArmMotion
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.arm.description import Arm
from tunenet_logs.terminal import listed, short_name

T = TypeVar("T")

# A recording that shows a mass: slower, shorter or more still, friction and offsets hide it. The
# repeated samples are a fraction of all but those of an arm at rest, which are no gap either.
_MIN_HZ = 8.0
_MIN_S, _REJECT_S = 3.0, 1.0
_MIN_SPAN_RAD = 0.3
_MAX_GAP_S = 0.3
_MAX_REPEATED = 0.7

# Velocities of the driver are like the positions' derivatives, and these below a multiple of the
# joint's limit: else positions or stamps are wrong.
_MIN_CORRELATION = 0.8
_FAST_FACTOR = 1.5

# Residuals by what joints are built for. Those of a good fit are a torque sensor's noise, half a
# percent; a simulated arm has no friction and no offsets, so that more remains.
_MAX_RMS, _REJECT_RMS, _MAX_SIMULATED = 0.03, 0.08, 0.15

# Of the square of a standard normal variable: makes a median an rms without spikes.
_CHI2_MEDIAN = 0.455

# No arm leaves this fraction of its torques' variance unexplained, where they vary by more than
# noise does, by what its joints are built for.
_REJECT_FRACTION = 0.5
_LIVELY = 0.03

# Natural log of the Bayes factor, and what speaks against an owner's own word. It comes of models
# that are linear about an empty arm, which are wrong by tens on an arm with much friction:
# strangers' arms whose weight was taken for a payload led by 4 to 13, the paper's circle is right
# by 29.
_SURE_ODDS, _CONTRADICTED = 15.0, -10.0

_MAX_LAG_S = 0.1  # drivers' filters are faster: more is two clocks
_TYPICAL_SDS = 8.0  # of a term's prior: beyond it something else is wrong with the arm
# Half of a 95 % interval that is of use, by what the arm weighs, or by the payload's mass where
# that is more; and of none at all.
_SURE_SHARE, _SURE_FRACTION, _REJECT_SHARE = 0.03, 0.1, 0.4

# Times its highest torque at which a joint's torques are not this arm's, or not in N·m. Scales of
# friction grow with such torques until they explain them.
_NO_ARM_LIFTS = 5.0

# Standard deviations below 0 at which a mass is an error of the model or of the tare.
_BELOW_SDS = 4.0

_CONVENTION_WORDS = {
    (1, True): "the joints' torques, with gravity",
    (-1, True): "torques with the sign opposite to the joints', with gravity",
    (1, False): "the joints' torques, without the arm's gravity",
    (-1, False): "torques with the sign opposite to the joints', without the arm's gravity",
}
_TILT_ADVICE = "an arm that does not stand upright needs its tilt in the base joint (--urdf)"
_ZERO_ADVICE = "set the torque sensors to zero in the candle pose, and check the arm (--urdf)"
_ARM_ADVICE = (
    "check that torques and positions are of the same joints, in N·m, and the arm (--arm, --urdf); "
    f"{_TILT_ADVICE}"
)
_CONVENTION_ADVICE = (
    "say it with --gravity and --effort-sign, or move the payload far out to the side, so that its "
    "weight shows"
)
_CONTRADICTION_ADVICE = (
    "check what --gravity and --effort-sign say: another convention fits far better"
)
_TARE_ADVICE = "record the empty gripper too and give it with --tare"


def arm_checks(log: ArmLog, motion: ArmMotion, arm: Arm) -> list[Check]:
    """Check an arm's log, independent of its payload."""
    position, velocity, _ = motion.at(motion.seconds)
    length_s = float(motion.seconds[-1] - motion.seconds[0])
    spans = np.ptp(position, axis=0)
    constant = [name for name, same in zip(log.joints, log.constant, strict=True) if same]
    slow_hz = min(log.position.rate_hz, log.effort.rate_hz)
    repeated = max(log.position.repeated, log.effort.repeated)
    gap_s = max(float(np.diff(field.seconds).max()) for field in (log.position, log.effort))
    return [
        Check(
            "long enough",
            length_s >= _MIN_S,
            f"{length_s:.1f} s of torques with their motion (wanted: {_MIN_S:.0f} or more)",
            fatal=length_s < _REJECT_S,
            advice="record 5 s of one smooth motion",
        ),
        Check(
            "the arm moves",
            float(spans.max()) >= _MIN_SPAN_RAD,
            f"the joint that moves most turns by {spans.max():.2f} rad (wanted: "
            f"{_MIN_SPAN_RAD} or more)",
            advice="move all joints by half a turn or so, the payload far out to the side",
        ),
        Check(
            "every torque changes",
            not constant,
            f"no change in the torque of {listed(map(short_name, constant))}: left out"
            if constant
            else "the torque of every joint changes",
            advice="check that the driver measures the torque of every joint",
        ),
        Check(
            "rate",
            slow_hz >= _MIN_HZ,
            f"positions are new at {log.position.rate_hz:.0f} Hz, torques at "
            f"{log.effort.rate_hz:.0f} Hz (wanted: {_MIN_HZ:.0f} or more)",
            advice="raise the driver's rate",
        ),
        Check(
            "samples are new",
            repeated <= _MAX_REPEATED,
            f"{100 * repeated:.0f} % of the samples repeat the one before, rests aside (at most "
            f"{100 * _MAX_REPEATED:.0f})",
            advice="record at the rate at which the driver measures",
        ),
        Check(
            "no gaps",
            gap_s <= _MAX_GAP_S,
            f"longest time without a new sample {gap_s:.2f} s (at most {_MAX_GAP_S})",
            advice="record on a machine that keeps up, or a shorter part with --start and --end",
        ),
        *_speed_checks(log, motion, velocity, arm),
    ]


def _speed_checks(log: ArmLog, motion: ArmMotion, velocity: Array, arm: Arm) -> list[Check]:
    """Check speeds, (T, J) [rad/s], against the arm's limits and the driver's velocities."""
    limits = np.array([joint.max_velocity_rad_s for joint in arm.joints])
    fractions = np.quantile(np.abs(velocity), 0.99, axis=0) / limits
    worst = int(np.argmax(fractions))
    speed_check = Check(
        "speeds are an arm's",
        float(fractions[worst]) < _FAST_FACTOR,
        f"{arm.joints[worst].name} moves at {100 * fractions[worst]:.0f} % of its highest speed "
        f"(at most {100 * _FAST_FACTOR:.0f})",
        advice="check the unit of the positions and the stamps, or name the arm with --urdf",
    )
    if log.velocity is None:
        return [speed_check]
    seconds = log.velocity.seconds
    inside = (seconds > motion.seconds[0]) & (seconds < motion.seconds[-1])
    measured = log.velocity.values[inside]
    if len(measured) < 3:
        return [speed_check]
    _, derived, _ = motion.at(seconds[inside])
    power = float(np.sqrt(np.sum(measured**2) * np.sum(derived**2)))
    if not power:
        return [speed_check]
    correlation = float(np.sum(measured * derived)) / power
    factor = float(np.sqrt(np.sum(measured**2) / np.sum(derived**2)))
    velocity_check = Check(
        "velocities agree",
        correlation > _MIN_CORRELATION,
        f"correlation {correlation:.2f} with the positions' derivatives (wanted: over "
        f"{_MIN_CORRELATION}), {factor:.2f} times them; they are not used",
        advice="check that positions are stamped when they are measured",
    )
    return [speed_check, velocity_check]


def payload_checks(fit: PayloadFit, arm: Arm, log: ArmLog, *, is_stated: bool) -> list[Check]:
    """Check a payload fit; a tare that fits no arm is blamed before the log.

    `is_stated` is whether the user states the driver's torque convention.
    """
    tare_checks = [
        _arm_check(
            f"{name}: torques fit the arm",
            residual,
            0.0,
            f"record the tare anew, and {_ARM_ADVICE}",
        )
        for name, residual in numbered("tare", fit.tare_residuals)
    ]
    usual = [term for term in fit.nuisances if term.group != "hoses and gears"]
    worst = max(usual, key=lambda term: abs(term.value) / term.prior_sd)
    sds = abs(worst.value) / worst.prior_sd
    return [
        *tare_checks,
        _arm_check("torques fit the arm", fit.residual, fit.arm_odds, _ARM_ADVICE),
        _convention_check(fit, is_stated=is_stated),
        Check(
            "lag",
            abs(fit.lag_s) < _MAX_LAG_S,
            f"torques are {1000 * fit.lag_s:.0f} ms behind the positions (at most "
            f"{1000 * _MAX_LAG_S:.0f} either way)",
            advice="stamp positions and torques with one clock, when they are measured",
        ),
        Check(
            "friction and sensors are usual",
            sds < _TYPICAL_SDS,
            f"{worst.name} is {worst.value:+.3g}, {sds:.1f} times what is usual (at most "
            f"{_TYPICAL_SDS:.0f})",
            advice=_TILT_ADVICE if worst.group == "tilt" else _ZERO_ADVICE,
        ),
        _lift_check(fit, arm, log),
    ]


def numbered(what: str, things: Sequence[T]) -> list[tuple[str, T]]:
    """Name things, by number if there are several."""
    names = [what] if len(things) == 1 else [f"{what} {at}" for at in range(1, len(things) + 1)]
    return list(zip(names, things, strict=True))


def _convention_check(fit: PayloadFit, *, is_stated: bool) -> Check:
    """Check whether the driver's torque convention is certain."""
    meant = _CONVENTION_WORDS[fit.convention.sign, fit.convention.has_gravity]
    if is_stated:
        return Check(
            "sign and gravity",
            fit.convention_odds > _CONTRADICTED,
            f"{meant}, as stated (log evidence {fit.convention_odds:.0f} over any other; wanted: "
            f"{_CONTRADICTED:.0f} or more)",
            advice=_CONTRADICTION_ADVICE,
        )
    return Check(
        "sign and gravity",
        fit.convention_odds > _SURE_ODDS,
        f"{meant} (log evidence {fit.convention_odds:.0f} over the next; wanted: "
        f"{_SURE_ODDS:.0f} or more)",
        advice=_CONVENTION_ADVICE,
    )


def _arm_check(name: str, residual: FitResidual, arm_odds: float, advice: str) -> Check:
    """Check whether any arm explains these torques."""
    left = residual.residual_nm / residual.scales_nm
    rms = float(np.sqrt(np.median(left**2, axis=0).mean() / _CHI2_MEDIAN))
    moving = (residual.effort_nm - np.mean(residual.effort_nm, axis=0)) / residual.scales_nm
    spread = float(np.sqrt(np.mean(moving**2)))
    lost = rms > _REJECT_RMS or arm_odds < 0
    if spread > _LIVELY:
        lost |= float(np.mean(left**2)) / spread**2 > _REJECT_FRACTION
    detail = (
        f"{100 * rms:.1f} % of what the joints are built for are left, rms (at most "
        f"{100 * _MAX_RMS:.0f}); torques change by {100 * spread:.1f} %"
    )
    if lost:
        detail = f"these torques fit no arm, of either sign: {detail}"
    return Check(name, rms < _MAX_RMS and not lost, detail, fatal=lost, advice=advice)


def _lift_check(fit: PayloadFit, arm: Arm, log: ArmLog) -> Check:
    """Check whether the arm can hold such a mass."""
    limits = np.array([joint.max_effort_nm for joint in arm.joints])
    fractions = np.quantile(np.abs(log.effort.values), 0.99, axis=0) / limits
    worst = int(np.argmax(fractions))
    below = -fit.held.signed_kg / fit.held.sd_kg
    zero = "that the tare's gripper was empty" if fit.tare_residuals else "its zero with a --tare"
    lost = bool(fractions[worst] > _NO_ARM_LIFTS)
    detail = (
        f"{fit.held.signed_kg:.3f} kg (0 or more); {arm.joints[worst].name} at "
        f"{100 * fractions[worst]:.0f} % of its highest torque"
    )
    return Check(
        "within what the arm lifts",
        float(fractions[worst]) < 1 and below < _BELOW_SDS,
        f"these torques fit no arm of this size: {detail}" if lost else detail,
        fatal=lost,
        advice=_ARM_ADVICE if lost else f"check the arm's model (--arm, --urdf), and {zero}",
    )


def sure_check(fit: PayloadFit, arm: Arm) -> Check:
    """Check whether the interval is narrow enough to be of use."""
    low, high = fit.held.interval95
    half = (high - low) / 2
    arm_kg = sum(joint.link.mass_kg for joint in arm.joints)
    most_kg = max(_SURE_SHARE * arm_kg, _SURE_FRACTION * fit.held.mass_kg)
    longer = "record longer, the payload far out to the side, the hand turning"
    return Check(
        "sure enough",
        half < most_kg,
        f"95 % interval of ±{half:.3f} kg (at most {most_kg:.2f})",
        fatal=half > _REJECT_SHARE * arm_kg,
        advice=longer if fit.tare_residuals else _TARE_ADVICE,
    )


def simulation_check(residual_nm: Array, scales_nm: Array) -> Check:
    """Check the simulated torques against the measured ones, all but nuisance terms.

    Args:
        residual_nm: Measured less simulated [N·m], shape (T, J).
        scales_nm: Rated torque of each joint [N·m], shape (J,).
    """
    rms = float(np.sqrt(np.mean((residual_nm / scales_nm) ** 2)))
    return Check(
        "simulation fits",
        rms < _MAX_SIMULATED,
        f"measured and simulated torques differ by {100 * rms:.1f} % of what the joints are built "
        f"for, rms, friction and offsets included (at most {100 * _MAX_SIMULATED:.0f})",
        advice="use the preset default, or check the arm (--urdf)",
    )
