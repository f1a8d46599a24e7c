"""Checks of a payload: the recording, an arm behind the torques, how sure the mass is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from analysis.checks import Check
from analysis.payload.arm_log import ArmLog
from analysis.payload.arm_motion import ArmMotion
from analysis.payload.fit_result import FitResidual, PayloadFit
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import listed, short_name

T = TypeVar("T")

_LEAST_HZ = 8.0
_LEAST_S, _REJECT_S = 3.0, 1.0
_LEAST_SPAN_RAD = 0.3
_MOST_GAP_S = 0.3
_MOST_REPEATED = 0.7
"""A recording that shows a mass: slower, shorter or more still, friction and offsets hide it. The
repeated samples are a fraction of all but those of an arm at rest, which are no gap either."""

_LEAST_CORRELATION = 0.8
_FAST_FACTOR = 1.5
"""Velocities of the driver are like the positions' derivatives, and these below a multiple of the
joint's limit: else positions or stamps are wrong."""

_MOST_RMS, _REJECT_RMS, _MOST_SIMULATED = 0.03, 0.08, 0.15
"""Residuals by what joints are built for. Those of a good fit are a torque sensor's noise, half a
percent; a simulated arm has no friction and no offsets, so that more remains."""

_CHI2_MEDIAN = 0.455
"""Of the square of a standard normal variable: makes a median an rms without spikes."""

_REJECT_FRACTION = 0.5
_LIVELY = 0.03
"""No arm leaves this fraction of its torques' variance unexplained, where they vary by more than
noise does, by what its joints are built for."""

_SURE_ODDS, _CONTRADICTED = 15.0, -10.0
"""Natural log of the Bayes factor, and what speaks against an owner's own word. It comes of models
that are linear about an empty arm, which are wrong by tens on an arm with much friction: strangers'
arms whose weight was taken for a payload led by 4 to 13, the paper's circle is right by 29."""

_MOST_LAG_S = 0.1
"""Drivers' filters are faster: more is two clocks."""

_USUAL_SDS = 8.0
"""Of a term's prior: beyond it something else is wrong with the arm."""

_SURE_SHARE, _SURE_FRACTION, _REJECT_SHARE = 0.03, 0.1, 0.4
"""Half of a 95 % interval that is of use, by what the arm weighs, or by the payload's mass where
that is more; and of none at all."""

_NO_ARM_LIFTS = 5.0
"""Times its highest torque at which a joint's torques are not this arm's, or not in N·m. Scales of
friction grow with such torques until they explain them."""

_BELOW_SDS = 4.0
"""Standard deviations below 0 at which a mass is an error of the model or of the tare."""

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
    """What speaks for and against a recording, whatever is in the gripper."""
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
            length_s >= _LEAST_S,
            f"{length_s:.1f} s of torques with their motion (wanted: {_LEAST_S:.0f} or more)",
            fatal=length_s < _REJECT_S,
            advice="record 5 s of one smooth motion",
        ),
        Check(
            "the arm moves",
            float(spans.max()) >= _LEAST_SPAN_RAD,
            f"the joint that moves most turns by {spans.max():.2f} rad (wanted: "
            f"{_LEAST_SPAN_RAD} or more)",
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
            slow_hz >= _LEAST_HZ,
            f"positions are new at {log.position.rate_hz:.0f} Hz, torques at "
            f"{log.effort.rate_hz:.0f} Hz (wanted: {_LEAST_HZ:.0f} or more)",
            advice="raise the driver's rate",
        ),
        Check(
            "samples are new",
            repeated <= _MOST_REPEATED,
            f"{100 * repeated:.0f} % of the samples repeat the one before, rests aside (at most "
            f"{100 * _MOST_REPEATED:.0f})",
            advice="record at the rate at which the driver measures",
        ),
        Check(
            "no gaps",
            gap_s <= _MOST_GAP_S,
            f"longest time without a new sample {gap_s:.2f} s (at most {_MOST_GAP_S})",
            advice="record on a machine that keeps up, or a shorter part with --start and --end",
        ),
        *_speed_checks(log, motion, velocity, arm),
    ]


def _speed_checks(log: ArmLog, motion: ArmMotion, velocity: Array, arm: Arm) -> list[Check]:
    """Whether speeds are an arm's, and like the driver's velocities, which are not used.

    Args:
        log: with these velocities, or without.
        motion: the positions over time.
        velocity: their derivatives [rad/s], shape (T, J).
        arm: with the speed limits.
    """
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
        correlation > _LEAST_CORRELATION,
        f"correlation {correlation:.2f} with the positions' derivatives (wanted: over "
        f"{_LEAST_CORRELATION}), {factor:.2f} times them; they are not used",
        advice="check that positions are stamped when they are measured",
    )
    return [speed_check, velocity_check]


def payload_checks(fit: PayloadFit, arm: Arm, log: ArmLog, *, is_stated: bool) -> list[Check]:
    """What speaks for and against the mass; a tare that fits no arm is blamed before the log.

    Args:
        fit: of the torques.
        arm: whose they are.
        log: with these torques.
        is_stated: whether the owner says what the driver means by torque.
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
            abs(fit.lag_s) < _MOST_LAG_S,
            f"torques are {1000 * fit.lag_s:.0f} ms behind the positions (at most "
            f"{1000 * _MOST_LAG_S:.0f} either way)",
            advice="stamp positions and torques with one clock, when they are measured",
        ),
        Check(
            "friction and sensors are usual",
            sds < _USUAL_SDS,
            f"{worst.name} is {worst.value:+.3g}, {sds:.1f} times what is usual (at most "
            f"{_USUAL_SDS:.0f})",
            advice=_TILT_ADVICE if worst.group == "tilt" else _ZERO_ADVICE,
        ),
        _lift_check(fit, arm, log),
    ]


def numbered(what: str, things: Sequence[T]) -> list[tuple[str, T]]:
    """What each is called: by its number where there are several."""
    names = [what] if len(things) == 1 else [f"{what} {at}" for at in range(1, len(things) + 1)]
    return list(zip(names, things, strict=True))


def _convention_check(fit: PayloadFit, *, is_stated: bool) -> Check:
    """Whether it is clear what the driver means by torque."""
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
    """Whether any arm is behind these torques."""
    left = residual.residual_nm / residual.scales_nm
    rms = float(np.sqrt(np.median(left**2, axis=0).mean() / _CHI2_MEDIAN))
    moving = (residual.effort_nm - np.mean(residual.effort_nm, axis=0)) / residual.scales_nm
    spread = float(np.sqrt(np.mean(moving**2)))
    lost = rms > _REJECT_RMS or arm_odds < 0
    if spread > _LIVELY:
        lost |= float(np.mean(left**2)) / spread**2 > _REJECT_FRACTION
    detail = (
        f"{100 * rms:.1f} % of what the joints are built for are left, rms (at most "
        f"{100 * _MOST_RMS:.0f}); torques change by {100 * spread:.1f} %"
    )
    if lost:
        detail = f"these torques fit no arm, of either sign: {detail}"
    return Check(name, rms < _MOST_RMS and not lost, detail, fatal=lost, advice=advice)


def _lift_check(fit: PayloadFit, arm: Arm, log: ArmLog) -> Check:
    """Whether the arm can hold such a mass."""
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
    """Whether the interval is narrow enough to be of use."""
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
    """Whether the simulated arm needs the torques that were measured, all but what is no mass's.

    Args:
        residual_nm: measured less simulated [N·m], shape (T, J).
        scales_nm: what each joint is built for [N·m], shape (J,).
    """
    rms = float(np.sqrt(np.mean((residual_nm / scales_nm) ** 2)))
    return Check(
        "simulation fits",
        rms < _MOST_SIMULATED,
        f"measured and simulated torques differ by {100 * rms:.1f} % of what the joints are built "
        f"for, rms, friction and offsets included (at most {100 * _MOST_SIMULATED:.0f})",
        advice="use the preset default, or check the arm (--urdf)",
    )
