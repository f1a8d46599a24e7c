"""Terms of an arm's torques beside the model's, with priors in groups of one scale each.

Sizes are fractions of each joint's rated torque, so that a wrist and a shoulder, a desk's arm and
a factory's, have the same table. The log decides on the scale of a group (`evidence.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analysis.payload.arm_motion import ArmMotion
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array

# Mass [kg], first moments [kg·m] (3), and what the inertia is more than a ball's [kg·m²] (6).
PAYLOAD_TERMS = 10

MASS = 0
CENTRE = slice(1, 4)
INERTIA = slice(4, 10)

CENTRE_SD_M = 0.05
INERTIA_SD_M2 = 0.003  # of a kilogram: where in a hand its centre may be, and how long it may be
WAVES = 8  # harmonics of a joint's angle: hoses that pull, and the slower part of a gear's ripple
# Of dry friction over speed, beside its sign: Stribeck's peak at three widths, and unevenness.
SHAPES = 4

# Usual ones. Of a joint's highest torque: offsets, friction (viscous for 1 rad/s), what depends on
# the angle, drifts; rotors for 1 rad/s². A fraction: friction under load.
_SIZES = {
    "offset": 0.01,
    "viscous friction": 0.02,
    "dry friction": 0.02,
    "friction at low speed": 0.01,
    "friction under load": 0.05,
    "rotor": 0.01,
    "drift": 0.003,
    "warming": 0.003,
    "hoses and gears": 0.01,
}

# Of a torque that a driver reports, and of one made of a motor's current: constants that two
# laboratories published for one kind of arm are 13 to 49 % apart.
GAIN, CURRENT_GAIN = 0.02, 0.12

# Errors of an arm's description: fractions, and of a centre for an arm of 1 m.
_LINK_MASS, _LINK_CENTRE_M, _LINK_INERTIA = 0.04, 0.003, 0.2

# Of a base about each level axis, of an encoder, of torques behind positions.
_TILT_RAD, _ZERO_RAD, _LAG_S = 0.01, 0.005, 0.02

# Of the highest torque of the joint that works hardest: where no log comes near it, the limits of a
# description are nobody's.
_MIN_LOAD = 0.25

# A joint without a known limit is built for this share of the hardest one's work at least.
_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class Terms:
    """Unknowns of some runs of one arm, the payload's first.

    Those of one joint are stored together, in the order of `own_groups`.

    Attributes:
        joints: Number of joints.
        runs: Number of runs; the first one is the log, the others are its tares.
        names: In words, of each of the N terms.
        groups: That are scaled together, of each.
        sds: Of the priors about 0 at scale 1, shape (N,); the payload's are per kilogram.
        scales_nm: Rated torque of each joint [N·m], shape (J,).
    """

    joints: int
    runs: int
    names: tuple[str, ...]
    groups: tuple[str, ...]
    sds: Array
    scales_nm: Array

    @cached_property
    def of(self) -> dict[str, NDArray[np.int64]]:
        """Indices of each group's terms."""
        groups = np.array(self.groups)
        return {name: np.flatnonzero(groups == name) for name in dict.fromkeys(self.groups)}

    @cached_property
    def arms(self) -> NDArray[np.int64]:
        """Indices of the arm's own terms, the same in any of its runs."""
        own = ("payload", "centre", "inertia", "lag", "drift", "warming")
        return np.flatnonzero(~np.isin(self.groups, own))


def torque_scales_nm(arm: Arm, motions: Sequence[ArmMotion], empty_nm: Sequence[Array]) -> Array:
    """Return each joint's rated torque, shape (J,): its limit, or by what the logs show."""
    shown = np.zeros(len(arm.joints))
    for motion, own_nm in zip(motions, empty_nm, strict=True):
        for torques in (motion.effort, own_nm):
            shown = np.maximum(shown, np.quantile(np.abs(torques), 0.99, axis=0))
    limits = np.array([joint.max_effort_nm for joint in arm.joints])
    shown = np.maximum(shown, _SHARE * shown.max())
    known = np.isfinite(limits)
    limits = np.where(known, limits, shown / _MIN_LOAD)
    load = float(np.max(shown / limits))
    return np.maximum(limits * min(1.0, load / _MIN_LOAD), 1e-3)


def make_terms(arm: Arm, scales_nm: Array, runs: int, *, drifts: bool, gain: float = GAIN) -> Terms:
    """Build the terms of an arm, for a log with its tares.

    Args:
        arm: Whose joints and links.
        scales_nm: Rated torque of each joint [N·m], shape (J,).
        runs: 1 for a log alone.
        drifts: Whether other runs share the offsets, so that each has its own drift of them.
        gain: Usual error of the torques, as a fraction.
    """
    numbers = range(1, len(arm.joints) + 1)
    axes = ("x", "y", "z")
    arm_kg = sum(joint.link.mass_kg for joint in arm.joints)
    reach_m = sum(float(np.linalg.norm(joint.origin_m)) for joint in arm.joints)
    table: list[tuple[str, str, float]] = [("payload", "payload", arm_kg)]
    table += [(f"centre {axis}", "centre", CENTRE_SD_M) for axis in axes]
    table += [(f"inertia {axis}", "inertia", INERTIA_SD_M2) for axis in _MOMENTS]
    table += [(f"mass of link {n}", "links", _LINK_MASS) for n in numbers]
    table += [
        (f"centre {axis} of link {n}", "links", _LINK_CENTRE_M * reach_m)
        for n in numbers
        for axis in axes
    ]
    table += [(f"inertia of link {n}", "links", _LINK_INERTIA) for n in numbers]
    table += [(f"tilt of the base about {axis}", "tilt", _TILT_RAD) for axis in axes[:2]]
    table += [(f"zero of encoder {n}", "zeros", _ZERO_RAD) for n in numbers]
    for n, scale in zip(numbers, scales_nm.tolist(), strict=True):
        table += _of_joint(n, scale, gain)
    for run in range(runs):
        of = "" if run == 0 else f" of tare {run}" if runs > 2 else " of the tare"
        table.append((f"lag{of}", "lag", _LAG_S))
        for what in ("drift", "warming"):
            table += [
                (
                    f"{what} of joint {n}{of}",
                    what,
                    _SIZES[what] * scale * (drifts or what != "drift"),
                )
                for n, scale in zip(numbers, scales_nm.tolist(), strict=True)
            ]
    names, groups, sds = zip(*table, strict=True)
    return Terms(len(arm.joints), runs, names, groups, np.array(sds), scales_nm)


def arm_terms(arm: Arm) -> tuple[str, ...]:
    """Return the names of the arm's own terms, the same in any of its runs (`Terms.arms`)."""
    terms = make_terms(arm, np.ones(len(arm.joints)), 1, drifts=True)
    return tuple(terms.names[index] for index in terms.arms.tolist())


# Groups that no plain simulation has.
NOT_SIMULATED = (
    *("offset", "friction", "friction at low speed", "friction under load", "rotor", "gain"),
    *("links", "tilt", "zeros", "hoses and gears", "drift", "warming"),
)

_MOMENTS = ("xx", "xy", "yy", "xz", "yz", "zz")

# Of one joint: offset, viscous and dry friction, its shapes, load, rotor, gain, waves.
OWN_TERMS = 6 + SHAPES + 2 * WAVES


def _of_joint(number: int, scale_nm: float, gain: float) -> list[tuple[str, str, float]]:
    def sized(what: str) -> float:
        return _SIZES[what] * scale_nm

    of = f"of joint {number}"
    table = [(f"offset {of}", "offset", sized("offset"))]
    table.append((f"viscous friction {of}", "friction", sized("viscous friction")))
    table.append((f"dry friction {of}", "friction", sized("dry friction")))
    slow = sized("friction at low speed")
    table += [
        (f"friction at low speed ({shape}) {of}", "friction at low speed", slow)
        for shape in range(1, SHAPES + 1)
    ]
    table.append(
        (f"friction under load {of}", "friction under load", _SIZES["friction under load"])
    )
    table.append((f"rotor {of}", "rotor", sized("rotor")))
    table.append((f"gain {of}", "gain", gain))
    pull = sized("hoses and gears")
    for wave in range(1, WAVES + 1):
        table += [
            (f"hoses and gear ({turn} {wave}) {of}", "hoses and gears", pull / wave)
            for turn in ("cos", "sin")
        ]
    return table
