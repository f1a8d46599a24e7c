"""Checks of a payload: the log, whether an arm explains the torques, precision of the mass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from tunenet_logs.analysis.checks import Check, CheckSpec, at_least, at_most, table, within
from tunenet_logs.analysis.payload.arm_log import ArmLog
from tunenet_logs.analysis.payload.torque_fit import FitResidual, PayloadFit
from tunenet_logs.analysis.payload.torque_model import ArmMotion
from tunenet_logs.recorders.simulators.arm.description import Arm
from tunenet_logs.terminal import listed, short_name

T = TypeVar("T")

_LOST_PERCENT = 8.0  # of what joints are built for, rms, from which on torques are no arm's
# [%] of its highest torque at which a joint's torques are not this arm's, or not in N·m. Scales of
# friction grow with such torques until they explain them.
_NO_ARM_LIFTS = 500.0
_TILT_ADVICE = "an arm that does not stand upright needs its tilt in the base joint (--urdf)"
_TARE_ADVICE = "record the empty gripper too and give it with --tare"
_LONGER_ADVICE = "record longer, the payload far out to the side, the hand turning"
_CONTRADICTION_ADVICE = (
    "check what --gravity and --effort-sign say: another convention fits far better"
)

PAYLOAD = table(
    CheckSpec(
        "long enough",
        at_least(3, "s", ".1f .0f", fatal=1),
        seen="{value} s of torques with their motion",
        measures="duration of torques and motion",
        advice="record 5 s of one smooth motion",
    ),
    CheckSpec(
        "the arm moves",
        at_least(0.3, "rad", ".2f g"),  # less is hidden by friction and offsets
        seen="the joint that moves most turns by {value} rad",
        measures="largest motion of a joint",
        advice="move all joints by half a turn or so, the payload far out to the side",
    ),
    CheckSpec(
        "every torque changes",
        at_most(0),
        measures="joints whose torque is constant, which are left out",
        passes="none",
        advice="check that the driver measures the torque of every joint",
    ),
    CheckSpec(
        "rate",
        at_least(8, "Hz"),
        seen="positions are new at {log.position.rate_hz:.0f} Hz, torques at "
        "{log.effort.rate_hz:.0f} Hz",
        measures="rate of new positions and torques",
        advice="raise the driver's rate",
    ),
    CheckSpec(
        "samples are new",
        at_most(70, "%"),
        seen="{value} % of the samples repeat the one before, rests aside",
        measures="samples that repeat the one before, rests aside",
        advice="record at the rate at which the driver measures",
    ),
    CheckSpec(
        "no gaps",
        at_most(0.3, "s", ".2f g"),
        seen="longest time without a new sample {value} s",
        measures="longest time without a new sample, rests aside",
        advice="record on a machine that keeps up, or a shorter part with --start and --end",
    ),
    CheckSpec(
        "speeds are an arm's",
        at_most(150, "%"),
        seen="{joint} moves at {value} % of its highest speed",
        measures="each joint's speed over its highest",
        advice="check the unit of the positions and the stamps, or name the arm with --urdf",
    ),
    CheckSpec(
        "velocities agree",
        at_least(0.8, "", ".2f g"),
        seen="correlation {value} with the positions' derivatives",
        wanted="wanted: over {limit}",
        more=", {factor:.2f} times them; they are not used",
        measures="correlation of the driver's velocities (not used) with the positions' "
        "derivatives",
        advice="check that positions are stamped when they are measured",
    ),
    CheckSpec(
        "torques fit the arm",
        at_most(3, "%", ".1f .0f", fatal=_LOST_PERCENT),
        seen="{lost}{value} % of what the joints are built for are left, rms",
        more="; torques change by {spread:.1f} %",
        measures="torques that are left, half a percent in a good fit (rms)",
        passes="at most {limit} % of what the joints are built for",
        if_not="r over 8, or where no arm explains the torques",
        advice="check that torques and positions are of the same joints, in N·m, and the arm "
        f"(--arm, --urdf); {_TILT_ADVICE}",
    ),
    CheckSpec(
        # Of models that are linear about an empty arm, which are wrong by tens on an arm with much
        # friction: strangers' arms whose weight was taken for a payload led by 4 to 13, the
        # paper's circle is right by 29.
        "sign and gravity",
        at_least(15),
        seen="{meant}",
        wanted="log evidence {value} over {others}; wanted: {limit} or more",
        measures="log evidence of what the driver means by torque over the next convention, of a "
        "stated one over any other",
        passes="{limit} or more; of a stated one -10",
        advice="say it with --gravity and --effort-sign, or move the payload far out to the side, "
        "so that its weight shows",
    ),
    CheckSpec(
        "lag",
        within(100, "ms"),  # drivers' filters are faster: more is two clocks
        seen="torques are {value} ms behind the positions",
        measures="lag of the torques behind the positions",
        advice="stamp positions and torques with one clock, when they are measured",
    ),
    CheckSpec(
        "friction and sensors are usual",
        at_most(8, "prior standard deviations", ".1f .0f"),
        seen="{term.name} is {term.value:+.3g}, {value} times what is usual",
        measures="most unusual term of friction, sensors and links",
        advice="set the torque sensors to zero in the candle pose, and check the arm (--urdf)",
    ),
    CheckSpec(
        "within what the arm lifts",
        at_most(100, "%", fatal=_NO_ARM_LIFTS),
        seen="{lost}{signed_kg:.3f} kg",
        wanted="0 or more",
        more="; {joint} at {value} % of its highest torque",
        measures="each torque over its joint's limit; how far the mass is below 0",
        passes="at most {limit} %; at most 4 standard deviations",
        advice="check the arm's model (--arm, --urdf), and its zero with a --tare",
    ),
    CheckSpec(
        "simulation fits",
        at_most(15, "%", ".1f .0f"),  # a simulated arm has no friction and no offsets
        seen="measured and simulated torques differ by {value} % of what the joints are built for, "
        "rms, friction and offsets included",
        measures="measured less simulated torques, friction and all (rms)",
        passes="at most {limit} % of what the joints are built for",
        advice="use the preset default, or check the arm (--urdf)",
    ),
    CheckSpec(
        "sure enough",
        at_most(3, "kg", ".3f .2f"),
        seen="95 % interval of ±{value} kg",
        measures="half the 95 % interval of the mass",
        passes="at most {limit} % of what the arm weighs (0.16 kg for a Jaco) or 10 % of the "
        "payload, if more",
        if_not="r over 40 % of what the arm weighs",
        advice=f"{_TARE_ADVICE}; with one, {_LONGER_ADVICE}",
    ),
)

_CONVENTION_WORDS = {
    (1, True): "the joints' torques, with gravity",
    (-1, True): "torques with the sign opposite to the joints', with gravity",
    (1, False): "the joints' torques, without the arm's gravity",
    (-1, False): "torques with the sign opposite to the joints', without the arm's gravity",
}


def arm_checks(log: ArmLog, motion: ArmMotion, arm: Arm) -> list[Check]:
    """Check an arm's log, independent of its payload."""
    position, velocity, _ = motion.at(motion.seconds)
    constant = [name for name, same in zip(log.joints, log.constant, strict=True) if same]
    detail = "the torque of every joint changes"
    if constant:
        detail = f"no change in the torque of {listed(map(short_name, constant))}: left out"
    slow_hz = min(log.position.rate_hz, log.effort.rate_hz)
    repeated = max(log.position.repeated, log.effort.repeated)
    gap_s = max(float(np.diff(field.seconds).max()) for field in (log.position, log.effort))
    # Speeds beside the arm's limits.
    limits = np.array([joint.max_velocity_rad_s for joint in arm.joints])
    fractions = np.quantile(np.abs(velocity), 0.99, axis=0) / limits
    fastest = int(np.argmax(fractions))
    checks = [
        PAYLOAD["long enough"].measured(float(motion.seconds[-1] - motion.seconds[0])),
        PAYLOAD["the arm moves"].measured(float(np.ptp(position, axis=0).max())),
        PAYLOAD["every torque changes"].measured(len(constant), detail=detail),
        PAYLOAD["rate"].measured(slow_hz, log=log),
        PAYLOAD["samples are new"].measured(100 * repeated),
        PAYLOAD["no gaps"].measured(gap_s),
        PAYLOAD["speeds are an arm's"].measured(
            100 * fractions[fastest], joint=arm.joints[fastest].name
        ),
    ]
    # The driver's velocities beside the positions' derivatives.
    if log.velocity is None:
        return checks
    seconds = log.velocity.seconds
    inside = (seconds > motion.seconds[0]) & (seconds < motion.seconds[-1])
    measured = log.velocity.values[inside]
    if len(measured) < 3:
        return checks
    _, derived, _ = motion.at(seconds[inside])
    power = float(np.sqrt(np.sum(measured**2) * np.sum(derived**2)))
    if not power:
        return checks
    correlation = float(np.sum(measured * derived)) / power
    factor = float(np.sqrt(np.sum(measured**2) / np.sum(derived**2)))
    return [*checks, PAYLOAD["velocities agree"].measured(correlation, factor=factor)]


def payload_checks(fit: PayloadFit, arm: Arm, log: ArmLog, *, is_stated: bool) -> list[Check]:
    """Check a payload fit; a tare that fits no arm is blamed before the log.

    `is_stated` is whether the user states the driver's torque convention.
    """
    tares = numbered("tare", fit.tare_residuals)
    usual = [term for term in fit.nuisances if term.group != "hoses and gears"]
    worst = max(usual, key=lambda term: abs(term.value) / term.prior_sd)
    # Whether the arm can hold such a mass: 4 sds below 0, it is an error of the model or the tare.
    spec = PAYLOAD["within what the arm lifts"]
    limits = np.array([joint.max_effort_nm for joint in arm.joints])
    percents = 100 * np.quantile(np.abs(log.effort.values), 0.99, axis=0) / limits
    most = int(np.argmax(percents))
    below_sds = -fit.held.signed_kg / fit.held.sd_kg
    is_lost = percents[most] > _NO_ARM_LIFTS
    advice = PAYLOAD["torques fit the arm"].advice if is_lost else None
    if fit.tare_residuals and not is_lost:
        advice = "check the arm's model (--arm, --urdf), and that the tare's gripper was empty"
    return [
        *(_arm_check(residual, 0.0, f"{name}: ") for name, residual in tares),
        _arm_check(fit.residual, fit.arm_odds),
        PAYLOAD["sign and gravity"].measured(
            fit.convention_odds,
            -10.0 if is_stated else None,  # that speaks against an owner's own word
            advice=_CONTRADICTION_ADVICE if is_stated else None,
            meant=_CONVENTION_WORDS[fit.convention.sign, fit.convention.has_gravity]
            + (", as stated" if is_stated else ""),
            others="any other" if is_stated else "the next",
        ),
        PAYLOAD["lag"].measured(1000 * fit.lag_s),
        PAYLOAD["friction and sensors are usual"].measured(
            abs(worst.value) / worst.prior_sd,
            advice=_TILT_ADVICE if worst.group == "tilt" else None,
            term=worst,
        ),
        spec.measured(
            percents[most],
            passed=percents[most] < spec.limit.value and below_sds < 4.0,
            advice=advice,
            lost="these torques fit no arm of this size: " if is_lost else "",
            signed_kg=fit.held.signed_kg,
            joint=arm.joints[most].name,
        ),
    ]


def numbered(what: str, things: Sequence[T]) -> list[tuple[str, T]]:
    """Name things, by number if there are several."""
    names = [what] if len(things) == 1 else [f"{what} {at}" for at in range(1, len(things) + 1)]
    return list(zip(names, things, strict=True))


def _arm_check(residual: FitResidual, arm_odds: float, tare: str = "") -> Check:
    """Check whether any arm explains these torques."""
    spec = PAYLOAD["torques fit the arm"]
    left = residual.residual_nm / residual.scales_nm
    # Medians without spikes: of a standard normal's square, it is .455.
    rms = float(np.sqrt(np.median(left**2, axis=0).mean() / 0.455))
    moving = (residual.effort_nm - np.mean(residual.effort_nm, axis=0)) / residual.scales_nm
    spread = float(np.sqrt(np.mean(moving**2)))
    lost = arm_odds < 0 or 100 * rms > _LOST_PERCENT
    if spread > 0.03:  # less is noise; of lively torques' variance no arm leaves half unexplained
        lost |= float(np.mean(left**2)) / spread**2 > 0.5
    check = spec.measured(
        100 * rms,
        passed=100 * rms < spec.limit.value and not lost,
        fatal=lost,
        advice=f"record the tare anew, and {spec.advice}" if tare else None,
        lost="these torques fit no arm, of either sign: " if lost else "",
        spread=100 * spread,
    )
    return replace(check, name=f"{tare}{check.name}")


def sure_check(fit: PayloadFit, arm: Arm) -> Check:
    """Check whether the interval is narrow enough to be of use."""
    spec = PAYLOAD["sure enough"]
    low, high = fit.held.interval95
    half_kg = (high - low) / 2
    arm_kg = sum(joint.link.mass_kg for joint in arm.joints)
    return spec.measured(
        half_kg,
        max(spec.limit.value / 100 * arm_kg, 0.1 * fit.held.mass_kg),
        fatal=half_kg > 0.4 * arm_kg,
        advice=_LONGER_ADVICE if fit.tare_residuals else _TARE_ADVICE,
    )
