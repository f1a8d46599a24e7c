"""Model the torques that a driver reports, as a function of unknown terms.

They are those of a rigid arm (link parameters near the model's, a base not quite level, encoders
off zero) and of its rotors and gears, times a gain, delayed by a lag, plus what sensors and hoses
add. A run with an empty gripper has the same terms, without the payload.

The rigid part is Pinocchio's joint-torque regressor: torques are linear in the masses, first
moments and inertias of links and payload (Atkeson, An and Hollerbach 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.payload.arm_log import MIN_KNOT_S, ArmLog, most_knots
from tunenet_logs.episode import Array
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.arm.description import (
    PAYLOAD_RADIUS_M,
    Arm,
    rotation_from_rpy,
)
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


# ---- Motion: joint positions smoothed by P-splines (Eilers and Marx 1996), differentiated twice
# Degree 5 on even knots, third differences as the penalty, so that accelerations are smooth too,
# and its weight by generalised cross-validation (Craven and Wahba 1979), for each joint.

# Left out at both ends: a spline's second derivative is poor where samples are on one side.
_ENDS_S = 0.25
_MIN_TORQUES = 20  # samples; fewer do not determine the terms of a fit
_MAX_TORQUES = 700  # samples of a fit: more cost time and add nothing, as an arm's motion is slow
_DEGREE = 5  # of the spline: its second derivative is a cubic, smooth itself
# Penalty weights that are compared: from interpolation to a parabola, four a decade.
_STIFFNESSES = np.logspace(-9, 7, 65)
_WINDOW_KNOTS = 300  # over which the stiffness is chosen; a long recording has the same throughout
_RIDGE = 1e-10  # fraction of the penalty that keeps knots without a sample determined


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """Torques, and the motion at any time between."""

    seconds: Array  # of the torques [s], shape (T,)
    effort: Array  # as reported by the driver [N·m], shape (T, J)
    used: NDArray[np.bool_]  # joints whose torque is informative, shape (J,)
    spline: BSpline  # positions of all joints [rad] over time [s]

    def at(self, seconds: Array) -> tuple[Array, Array, Array]:
        """Return positions [rad], velocities [rad/s] and accelerations [rad/s^2], each (T, J)."""
        position, velocity, acceleration = (self.spline(seconds, order) for order in range(3))
        return position, velocity, acceleration


def arm_motion(log: ArmLog) -> ArmMotion:
    """Smooth the positions by P-splines, with generalised cross-validation.

    The first and last quarter of a second are left out, and torques in gaps of the positions.
    """
    positions, efforts = log.position.seconds, log.effort.seconds
    angles = log.position.values
    # Single samples at which no arm can have been between the two beside them.
    off = np.zeros(len(angles))
    aside = np.abs(angles[1:-1] - (angles[2:] + angles[:-2]) / 2)
    # A single sample is an outlier where it is off the middle of its neighbours by more than this
    # angle and this multiple of the median [rad]
    usual = np.maximum(20.0 * np.median(aside, axis=0), 0.05)
    off[1:-1] = np.max(aside / usual, axis=1)
    most = np.maximum(off, np.maximum(np.roll(off, 1), np.roll(off, -1)))
    inliers = ~((off > 1) & (off == most))
    spline = smoothing_spline(positions[inliers], angles[inliers], log.position.late_s)
    after = np.clip(np.searchsorted(positions, efforts), 1, len(positions) - 1)
    gaps = np.diff(positions)
    # A gap of the positions within which the motion is unknown: longer than both [s]
    most_s = max(5.0 * float(np.median(gaps)), 0.25)
    inside = (efforts > positions[0] + _ENDS_S) & (efforts < positions[-1] - _ENDS_S)
    keep = inside & (gaps[after - 1] < most_s)
    if np.count_nonzero(keep) < _MIN_TORQUES:
        raise NotFoundError(
            f"{np.count_nonzero(keep)} torques have positions about them (wanted: "
            f"{_MIN_TORQUES} or more): record both at once, for 5 s"
        )
    seconds, effort = efforts[keep], log.effort.values[keep]
    if len(seconds) > _MAX_TORQUES:  # means over short spans
        since = seconds - seconds[0]
        width = float(since[-1]) / (_MAX_TORQUES - 1)
        spans = (since / width).astype(np.int64)
        # Over .05 s the torques of an arm hardly change: such spans are averaged.
        near = since - spans * width < 0.05
        _, spans, counts = np.unique(spans[near], return_inverse=True, return_counts=True)
        rows = np.column_stack([seconds[near], effort[near]])
        sums = np.zeros((len(counts), rows.shape[1]))
        np.add.at(sums, spans, rows)
        means = sums / counts[:, None]
        seconds, effort = means[:, 0], means[:, 1:]
    return ArmMotion(seconds, effort, ~log.constant, spline)


def smoothing_spline(seconds: Array, values: Array, late_s: float = 0.0) -> BSpline:
    """Fit a P-spline to each column of samples at `seconds`, shape (T,), stamped up to `late_s`.

    Errors of late stamps are correlated, which cross-validation takes for the curve: so residuals
    stay at least as large as they make.
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import dia_array
    from scipy.sparse.linalg import splu

    step = max(float(np.median(np.diff(seconds))), MIN_KNOT_S)
    cells = int(np.ceil((seconds[-1] - seconds[0]) / step))
    cells = min(max(cells, _DEGREE), most_knots(len(seconds)))
    step = (seconds[-1] - seconds[0]) / cells
    knots = seconds[0] + step * np.arange(-_DEGREE, cells + _DEGREE + 1)
    design = BSpline.design_matrix(seconds, knots, _DEGREE, extrapolate=True).tocsc()
    count = cells + _DEGREE
    weights = np.tile([[-1.0], [3.0], [-3.0], [1.0]], count)
    third = dia_array((weights, np.arange(4)), shape=(count - 3, count))
    normal, penalty = (design.T @ design).tocsc(), (third.T @ third).tocsc()
    speeds = np.diff(values, axis=0) / np.diff(seconds)[:, None]
    floor = late_s**2 / 12 * np.mean(speeds**2, axis=0)  # variance of a uniform delay, times speed
    early = seconds <= knots[_DEGREE + min(cells, _WINDOW_KNOTS)]
    size = min(cells, _WINDOW_KNOTS) + _DEGREE
    inner = third.tocsr()[: size - 3, :size].toarray()  # a difference cut off would pull to 0
    stiffnesses = _stiffnesses(
        design[early][:, :size].toarray(), inner.T @ inner, values[early], floor
    )
    right_sides = design.T @ values
    coefficients = [
        splu(normal + (stiffness + _RIDGE) * penalty).solve(column)
        for stiffness, column in zip(stiffnesses, right_sides.T, strict=True)
    ]
    return BSpline(knots, np.column_stack(coefficients), _DEGREE, extrapolate=True)


def _stiffnesses(design: Array, penalty: Array, values: Array, floor: Array) -> Array:
    """Choose each column's penalty weight, shape (C,), by generalised cross-validation.

    In the basis that makes both matrices diagonal (Demmler and Reinsch 1975) a stiffness only
    shrinks each coordinate, so that all of them are compared at the cost of one. `design` (T, K),
    `penalty` (K, K).
    """
    from scipy.linalg import eigh

    normal = design.T @ design
    powers, basis = eigh(penalty, normal + _RIDGE * penalty)
    powers = np.maximum(powers, 0.0)
    curves = design @ basis
    amounts = curves.T @ values
    shrinkage = 1 / (1 + _STIFFNESSES[:, None] * powers)
    squares = np.sum(values**2, axis=0) - 2 * shrinkage @ amounts**2 + shrinkage**2 @ amounts**2
    # A degree of freedom costs 1.4: with 1, cross-validation follows noise too often (Gu 2002).
    freedom = len(values) - 1.4 * shrinkage.sum(axis=1)
    scores = np.maximum(squares, 0.0) / np.maximum(freedom, 1e-3)[:, None] ** 2
    scores[freedom <= 0] = np.inf
    variance = squares / np.maximum(len(values) - shrinkage.sum(axis=1), 1.0)[:, None]
    scores[(variance < floor) & (variance < variance[-1])] = np.inf
    return _STIFFNESSES[np.argmin(scores, axis=0)]


# ---- Terms beside the model's, with priors in groups of one scale each
# Sizes are fractions of each joint's rated torque, so that a wrist and a shoulder, a desk's arm and
# a factory's, have the same table. The log decides on the scale of a group (`noise.py`).

# Mass [kg], first moments [kg·m] (3), and what the inertia is more than a ball's [kg·m²] (6).
PAYLOAD_TERMS = 10
MASS = 0
CENTRE = slice(1, 4)
INERTIA = slice(4, 10)
CENTRE_SD_M = 0.05  # of a kilogram: where in a hand its centre may be
INERTIA_SD_M2 = 0.003  # of a kilogram: how long it may be
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


@dataclass(frozen=True, eq=False)
class Terms:
    """Unknowns of some runs of one arm, the payload's first.

    Those of one joint are stored together, in the order of `_of_joint`.
    """

    joints: int  # number of joints
    runs: int  # number of runs; the first one is the log, the others are its tares
    names: tuple[str, ...]  # in words, of each of the N terms
    groups: tuple[str, ...]  # that are scaled together, of each
    sds: Array  # of the priors about 0 at scale 1, shape (N,); the payload's are per kilogram
    scales_nm: Array  # rated torque of each joint [N·m], shape (J,)

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
    # A joint without a known limit is built for this share of the hardest one's work at least
    shown = np.maximum(shown, 0.1 * shown.max())
    known = np.isfinite(limits)
    limits = np.where(known, limits, shown / _MIN_LOAD)
    load = float(np.max(shown / limits))
    return np.maximum(limits * min(1.0, load / _MIN_LOAD), 1e-3)


def make_terms(arm: Arm, scales_nm: Array, runs: int, *, drifts: bool, gain: float = GAIN) -> Terms:
    """Build the terms of an arm for a log with its tares, of rated torques (J,) [N·m].

    Where other runs share the offsets, each has its own drift of them.
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


# ---- Torques of a run, rigid and of the joints' own terms, linearised about any values

# Speeds over which friction falls from its peak: Stribeck's are between them.
_SHAPE_RAD_S = (0.03, 0.1, 0.3)
# Of one body in Pinocchio: mass, first moments (3), and the inertia about the joint's frame as xx,
# xy, yy, xz, yz, zz, which is its lower triangle by rows.
_BODY_PARAMETERS = 10
# Of a joint's own terms: what is a gear's, between the arm and the sensor; and what is not.
_OFFSET, _LOAD_WAY, _LOAD, _GAIN = 0, 2, 7, 9
_GEAR = slice(1, 9)
_BESIDE = [_OFFSET, *range(10, OWN_TERMS)]


@dataclass(frozen=True)
class Convention:
    """Torque convention of a driver."""

    sign: int  # +1 if it is the joint's torque, -1 if it is the load's
    has_gravity: bool  # whether the arm's own weight is included


CONVENTIONS = tuple(Convention(sign, full) for full in (True, False) for sign in (1, -1))


@dataclass(frozen=True, eq=False)
class RigidTorques:
    """Torques of a rigid arm along a motion, with its links and payload as fitted."""

    total_nm: Array  # shape (T, J)
    slopes: Array  # by the payload's terms, the links', the tilt and the encoder zeros: (T, J, C)


class ArmModel:
    """Rigid-body model of the arm in Pinocchio."""

    def __init__(self, arm: Arm) -> None:
        self._library: Any = import_module("pinocchio")
        self._model: Any = self._library.buildModelFromXML(arm.urdf())
        self._data: Any = self._model.createData()
        self._links = np.stack([one.toDynamicParameters() for one in self._model.inertias[1:]])
        # The last body's inertial parameters by the payload's terms, shape (10, 10).
        rotation = rotation_from_rpy(arm.tool_from_last_rpy)
        tool = np.array(arm.tool_from_last_m)
        parameters = np.zeros((_BODY_PARAMETERS, PAYLOAD_TERMS))
        parameters[0, MASS] = 1.0
        parameters[1:4, MASS] = tool
        parameters[1:4, CENTRE] = rotation
        ball = 0.4 * PAYLOAD_RADIUS_M**2 * np.eye(3)
        inertias = [ball + tool @ tool * np.eye(3) - np.outer(tool, tool)]
        for axis in rotation.T:
            crossed = np.outer(tool, axis)
            inertias.append(2 * tool @ axis * np.eye(3) - crossed - crossed.T)
        inertias += [rotation @ moment @ rotation.T for moment in moments()]
        for column, inertia in enumerate(inertias):
            parameters[4:, column] = inertia[np.tril_indices(3)]
        self._payload = parameters

    def empty_nm(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Compute torques of the arm as described (Newton-Euler), along a motion of (T, J)."""
        self._become(self._links, np.zeros(2))
        rows = zip(position, velocity, acceleration, strict=True)
        model, data, rnea = self._model, self._data, self._library.rnea
        return np.stack([rnea(model, data, *row).copy() for row in rows])

    def gravity_nm(self, position: Array) -> Array:
        """Compute gravity torques of the arm as described [N·m], shape (T, J)."""
        self._become(self._links, np.zeros(2))
        return self._held_nm(position)

    def torques(
        self, position: Array, velocity: Array, acceleration: Array, values: Array, *, held: bool
    ) -> RigidTorques:
        """Compute torques along a motion, with their derivatives by the terms (regressor).

        `position` (T, J) [rad], `velocity` (T, J) [rad/s], `acceleration` (T, J) [rad/s^2],
        """
        count = position.shape[1]
        first = PAYLOAD_TERMS
        masses, centres_m, inertias, tilt = np.split(
            values[first : first + 5 * count + 2], [count, 4 * count, 5 * count]
        )
        bodies = self._links * (1 + masses[:, None])
        bodies[:, 1:4] += self._links[:, :1] * centres_m.reshape(count, 3)
        bodies[:, 4:] += self._links[:, 4:] * inertias[:, None]
        if held:
            bodies[-1] += self._payload @ values[:first]
        self._become(bodies, tilt)
        model, data, library = self._model, self._data, self._library
        regressors, by_angle = [], []
        for row in zip(position, velocity, acceleration, strict=True):
            regressors.append(library.computeJointTorqueRegressor(model, data, *row).copy())
            by_angle.append(library.computeRNEADerivatives(model, data, *row)[0].copy())
        regressor = np.stack(regressors).reshape(*position.shape, count, _BODY_PARAMETERS)
        slopes = np.zeros((*position.shape, first + 6 * count + 2))
        if held:
            slopes[..., :first] = regressor[:, :, -1] @ self._payload
        at = first
        slopes[..., at : at + count] = np.einsum("tjlp,lp->tjl", regressor, self._links)
        at += count
        by_centre = regressor[..., 1:4] * self._links[:, :1]
        slopes[..., at : at + 3 * count] = by_centre.reshape(*position.shape, -1)
        at += 3 * count
        slopes[..., at : at + count] = np.einsum(
            "tjlp,lp->tjl", regressor[..., 4:], self._links[:, 4:]
        )
        at += count
        for axis in range(2):
            model.gravity.linear = GRAVITY_M_S2 * np.eye(3)[axis]
            slopes[..., at + axis] = self._held_nm(position)
        slopes[..., at + 2 :] = np.stack(by_angle)
        return RigidTorques(np.einsum("tjlp,lp->tj", regressor, bodies), slopes)

    def _held_nm(self, position: Array) -> Array:
        compute = self._library.computeGeneralizedGravity
        return np.stack([compute(self._model, self._data, row).copy() for row in position])

    def _become(self, bodies: Array, tilt: Array) -> None:
        """Set the links' parameters, shape (J, 10), and the tilt of gravity, shape (2,)."""
        down = -np.sqrt(max(1.0 - float(tilt @ tilt), 0.0))
        self._model.gravity.linear = GRAVITY_M_S2 * np.array([*tilt, down])
        for index, body in enumerate(bodies, 1):
            own = body.copy()
            # A link's mass [kg], whatever a fit makes of it on its way
            own[0] = max(own[0], 1e-6)
            self._model.inertias[index] = self._library.Inertia.FromDynamicParameters(own)


def moments() -> list[Array]:
    """Return the unit tensors of the six moments of inertia, in order, each (3, 3)."""
    tensors = []
    for row, column in zip(*np.tril_indices(3), strict=True):
        tensor = np.zeros((3, 3))
        tensor[row, column] = tensor[column, row] = 1.0
        tensors.append(tensor)
    return tensors


def smooth_sign(velocity: Array) -> Array:
    """Return the sign of velocities [rad/s], smoothed about 0, which is known to .015 rad/s."""
    return np.tanh(velocity / 0.015)


@dataclass(frozen=True, eq=False)
class Linearization:
    """Torques linearised about some values of the terms."""

    predicted_nm: Array  # at these values [N·m], shape (T, J)
    columns: NDArray[np.int64]  # terms that each joint's slopes are by, shape (J, C)
    slopes: Array  # derivatives, shape (T, J, C)

    def moved_nm(self, change: Array) -> Array:
        """Return the change of torques, (T, J), for a change of the terms, shape (N,)."""
        return np.einsum("tjc,jc->tj", self.slopes, change[self.columns])


@dataclass(frozen=True, eq=False)
class LoggedArm:
    """Torque model of one run."""

    model: ArmModel  # the arm's
    terms: Terms  # of all runs that are fitted together
    motion: ArmMotion  # this one's
    run: int  # 0 for the log itself, from 1 for its tares
    # for a tare along the log's path, which of the log's times it covers; None for any other run
    covered: NDArray[np.bool_] | None = None

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Measured samples, shape (T,): a tare along the log's path may not cover it."""
        return np.ones(len(self.motion.seconds), bool) if self.covered is None else self.covered

    def torques_nm(self, convention: Convention) -> Array:
        """Return measured torques with the joint's sign [N·m], shape (T, J)."""
        return convention.sign * self.motion.effort

    @property
    def columns(self) -> NDArray[np.int64]:
        """Indices of the terms that each joint's torques depend on, shape (J, C).

        First what all joints share, the lag last of it; then the joint's own; then its drifts.
        """
        joints = self.terms.joints
        common = np.arange(PAYLOAD_TERMS + 6 * joints + 2)
        own = len(common) + np.arange(joints)[:, None] * OWN_TERMS + np.arange(OWN_TERMS)
        lag = len(common) + joints * OWN_TERMS + self.run * (1 + 2 * joints)
        drifts = lag + 1 + np.arange(joints)[:, None] + joints * np.arange(2)
        return np.hstack([np.tile(np.append(common, lag), (joints, 1)), own, drifts])

    def linearized(self, values: Array, convention: Convention) -> Linearization:
        """Linearise the torques about values of the terms, shape (N,)."""
        columns, joints, seconds = self.columns, self.terms.joints, self.motion.seconds
        first = columns.shape[1] - OWN_TERMS - 2
        of_joint = values[columns[:, first : first + OWN_TERMS]]
        zeros = values[first - 1 - joints : first - 1]
        said, velocity, acceleration = self.motion.at(seconds - values[columns[0, first - 1]])
        rigid = self.model.torques(said + zeros, velocity, acceleration, values, held=self.run == 0)
        # The regressors of the joints' own terms, (T, J, OWN_TERMS); gains are 0.
        way = smooth_sign(velocity)
        slow = [way * np.exp(-((velocity / width) ** 2)) for width in _SHAPE_RAD_S]
        angles = [wave * said for wave in range(1, WAVES + 1)]
        waves = [turn(angle) for angle in angles for turn in (np.cos, np.sin)]
        ones, load = np.ones_like(way), np.abs(rigid.total_nm) * way
        gear = [velocity, way, *slow, way**2, load, acceleration]
        own = np.stack([ones, *gear, np.zeros_like(way), *waves], axis=-1)
        gains = 1 + of_joint[:, _GAIN]
        carried = 1 + of_joint[:, _LOAD] * np.sign(rigid.total_nm) * own[..., _LOAD_WAY]
        felt_nm = rigid.total_nm + np.einsum("tjc,jc->tj", own[..., _GEAR], of_joint[:, _GEAR])
        own[..., _GEAR] *= gains[:, None]
        own[..., _GAIN] = felt_nm
        drifts = np.stack([np.ones_like(said), np.zeros_like(said)], axis=-1)
        drifts[..., 1] = np.linspace(-1.0, 1.0, len(seconds))[:, None]
        beside = np.einsum("tjc,jc->tj", own[..., _BESIDE], of_joint[:, _BESIDE])
        beside += np.einsum("tjc,jc->tj", drifts, values[columns[:, -2:]])
        moving_nm = gains * felt_nm + beside
        if not convention.has_gravity:
            moving_nm = moving_nm - self.model.gravity_nm(said)
        lags = -np.gradient(moving_nm, seconds, axis=0)[..., None]
        shared = rigid.slopes * (gains * carried)[..., None]
        return Linearization(moving_nm, columns, np.concatenate([shared, lags, own, drifts], -1))
