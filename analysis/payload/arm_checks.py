"""Checks of an arm's recording: what the file tells before anything is fitted."""

from __future__ import annotations

import numpy as np

from analysis.drop.checks import Check
from analysis.payload.arm_log import ArmLog, Samples
from analysis.payload.arm_motion import ArmMotion
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array
from tunenet_logs.wording import listed, short_name

_LEAST_HZ = 8.0
_LEAST_S, _REJECT_S = 3.0, 1.0
_LEAST_SPAN_RAD = 0.3
_MOST_GAP_S = 0.3
_MOST_REPEATED = 0.7
_ALIKE = 0.8
_FAST = 1.5


def arm_checks(log: ArmLog, motion: ArmMotion, arm: Arm) -> list[Check]:
    """What speaks for and against a recording, whatever is in the gripper."""
    position, velocity, _ = motion.at(motion.seconds)
    length_s = float(motion.seconds[-1] - motion.seconds[0])
    spans = np.ptp(position, axis=0)
    constant = [name for name, one in zip(log.joints, log.constant, strict=True) if one]
    slow_hz = min(log.position.rate_hz, log.effort.rate_hz)
    repeated = max(log.position.repeated, log.effort.repeated)
    gap_s = max(_longest_gap(log.position), _longest_gap(log.effort))
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
            f"{100 * repeated:.0f} % of the samples repeat the one before (at most "
            f"{100 * _MOST_REPEATED:.0f})",
            advice="record at the rate at which the driver measures",
        ),
        Check(
            "no gaps",
            gap_s <= _MOST_GAP_S,
            f"longest time without a new sample {gap_s:.2f} s (at most {_MOST_GAP_S})",
            advice="record on a machine that keeps up, or a shorter part with --start and --end",
        ),
        _speed_check(velocity, arm),
        *_velocity_checks(log, motion),
    ]


def _longest_gap(samples: Samples) -> float:
    return float(np.diff(samples.seconds).max())


def _speed_check(velocity: Array, arm: Arm) -> Check:
    """Positions that jump make speeds that no arm has."""
    limits = np.array([one.max_velocity_rad_s for one in arm.joints])
    shares = np.quantile(np.abs(velocity), 0.99, axis=0) / limits
    worst = int(np.argmax(shares))
    return Check(
        "speeds are an arm's",
        float(shares[worst]) < _FAST,
        f"{arm.joints[worst].name} moves at {100 * shares[worst]:.0f} % of its highest speed (at "
        f"most {100 * _FAST:.0f})",
        advice="check the unit of the positions and the stamps, or name the arm with --urdf",
    )


def _velocity_checks(log: ArmLog, motion: ArmMotion) -> list[Check]:
    """Whether the driver's velocities, which are not used, are those of its positions."""
    if log.velocity is None:
        return []
    inside = (log.velocity.seconds > motion.seconds[0]) & (
        log.velocity.seconds < motion.seconds[-1]
    )
    if np.count_nonzero(inside) < 3:
        return []
    told = log.velocity.values[inside]
    _, derived, _ = motion.at(log.velocity.seconds[inside])
    power = float(np.sqrt(np.sum(told**2) * np.sum(derived**2)))
    if not power:
        return []
    alike = float(np.sum(told * derived)) / power
    factor = float(np.sqrt(np.sum(told**2) / np.sum(derived**2)))
    return [
        Check(
            "velocities agree",
            alike > _ALIKE,
            f"correlation {alike:.2f} with the positions' derivatives (wanted: over {_ALIKE}), "
            f"{factor:.2f} times them; they are not used",
            advice="check that positions are stamped when they are measured",
        )
    ]
