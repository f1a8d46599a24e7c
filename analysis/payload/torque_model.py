"""Model the torques that a driver reports, as a function of unknown terms.

They are those of a rigid arm (link parameters near the model's, a base not quite level, encoders
off zero) and of its rotors and gears, times a gain, delayed by a lag, plus what sensors and hoses
add. The rigid part is Pinocchio's joint-torque regressor: torques are linear in the masses, first
moments and inertias of links and payload (Atkeson, An and Hollerbach 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, solve_banded

from tunenet_logs.analysis.payload.arm_log import MIN_KNOT_S, ArmLog, most_knots
from tunenet_logs.episode import Array, median_step
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.arm.description import (
    PAYLOAD_RADIUS_M,
    Arm,
    rotation_from_rpy,
)
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

# ---- Motion: joint positions smoothed by P-splines (Eilers and Marx 1996), differentiated twice
# Degree 5 on even knots, third differences as the penalty, so that accelerations are smooth too,
# and its weight by generalised cross-validation (Craven and Wahba 1979), for each joint.

_DEGREE = 5  # of the spline: its second derivative is a cubic, smooth itself
_RIDGE = 1e-10  # fraction of the penalty that keeps knots without a sample determined


def _pieces() -> Array:
    """Return the B-splines on one cell of even knots by de Boor's recursion: powers of its part.

    Of each in turn the coefficients, lowest power first, shape (6, 6).
    """
    found = np.ones((1, 1))
    for degree in range(1, _DEGREE + 1):
        before, found = found, np.zeros((degree + 1, degree + 1))
        for number, one in enumerate(before):
            # The one before it rises with the part, and it falls.
            found[number + 1, :-1] += (degree - 1 - number) * one / degree
            found[number + 1, 1:] += one / degree
            found[number, :-1] += (number + 1) * one / degree
            found[number, 1:] -= one / degree
    return found


_PIECES = _pieces()


@dataclass(frozen=True, eq=False)
class EvenSpline:
    """Spline on even knots; beyond them its last pieces go on."""

    start_s: float
    step_s: float  # between knots
    coefficients: Array  # shape (cells + 5, J)

    def __call__(self, seconds: Array, order: int = 0) -> Array:
        """Evaluate it, or a derivative of an order, shape (T, J)."""
        cells = len(self.coefficients) - _DEGREE
        cell, basis = even_basis((seconds - self.start_s) / self.step_s, cells, order)
        found = np.zeros((len(seconds), self.coefficients.shape[1]))
        for number, column in enumerate(basis.T):
            found += column[:, None] * self.coefficients[cell + number]
        return found / self.step_s**order


def even_basis(places: Array, cells: int, order: int = 0) -> tuple[NDArray[np.intp], Array]:
    """Return the cells of places [knots], shape (T,), and their six B-splines there, (T, 6).

    Of the coefficients it is the cell's number on that count. Or the derivatives of an order.
    """
    cell = np.clip(np.floor(places), 0, cells - 1).astype(np.intp)
    powers = np.vander(places - cell, _DEGREE + 1, increasing=True)
    pieces = _PIECES
    for _ in range(order):
        pieces = pieces[:, 1:] * np.arange(1, pieces.shape[1])
    return cell, powers[:, : pieces.shape[1]] @ pieces.T


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """Torques, and the motion at any time between."""

    seconds: Array  # of the torques [s], shape (T,)
    effort: Array  # as reported by the driver [N·m], shape (T, J)
    used: NDArray[np.bool_]  # joints whose torque is informative, shape (J,)
    spline: EvenSpline  # positions of all joints [rad] over time [s]

    def at(self, seconds: Array) -> tuple[Array, Array, Array]:
        """Return positions [rad], velocities [rad/s] and accelerations [rad/s^2], each (T, J)."""
        return self.spline(seconds, 0), self.spline(seconds, 1), self.spline(seconds, 2)


def arm_motion(log: ArmLog) -> ArmMotion:
    """Smooth the positions, and average the torques that have positions about them."""
    positions, efforts = log.position.seconds, log.effort.seconds
    angles = log.position.values
    # Single samples at which no arm can have been between the two beside them.
    off = np.zeros(len(angles))
    aside = np.abs(angles[1:-1] - (angles[2:] + angles[:-2]) / 2)
    # By how much it is off their middle: this multiple of the median, and this angle [rad].
    usual = np.maximum(20.0 * np.median(aside, axis=0), 0.05)
    off[1:-1] = np.max(aside / usual, axis=1)
    most = np.maximum(off, np.maximum(np.roll(off, 1), np.roll(off, -1)))
    inliers = ~((off > 1) & (off == most))
    spline = smoothing_spline(positions[inliers], angles[inliers], log.position.late_s)
    after = np.clip(np.searchsorted(positions, efforts), 1, len(positions) - 1)
    gaps = np.diff(positions)
    # A gap of the positions within which the motion is unknown: longer than both [s]
    most_s = max(5.0 * float(np.median(gaps)), 0.25)
    # A spline's second derivative is poor within a quarter of a second of its ends.
    inside = (efforts > positions[0] + 0.25) & (efforts < positions[-1] - 0.25)
    keep = inside & (gaps[after - 1] < most_s)
    least, most = 20, 700  # torques: fewer tell too little; more add nothing to a slow motion
    if np.count_nonzero(keep) < least:
        raise NotFoundError(
            f"{np.count_nonzero(keep)} torques have positions about them (wanted: "
            f"{least} or more): record both at once, for 5 s"
        )
    seconds, effort = efforts[keep], log.effort.values[keep]
    if len(seconds) > most:  # means over short spans
        since = seconds - seconds[0]
        width = float(since[-1]) / (most - 1)
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


def smoothing_spline(seconds: Array, values: Array, late_s: float = 0.0) -> EvenSpline:
    """Fit a P-spline to each column of samples at `seconds`, shape (T,), stamped up to `late_s`.

    Errors of late stamps are correlated, which cross-validation takes for the curve: so residuals
    stay at least as large as they make.
    """
    step = max(median_step(seconds), MIN_KNOT_S)
    cells = int(np.ceil((seconds[-1] - seconds[0]) / step))
    cells = min(max(cells, _DEGREE), most_knots(len(seconds)))
    step = float(seconds[-1] - seconds[0]) / cells
    places, count = (seconds - seconds[0]) / step, cells + _DEGREE
    cell, design = even_basis(places, cells)
    third = np.array([-1.0, 3.0, -3.0, 1.0])
    normal = _banded([cell + number for number in range(_DEGREE + 1)], design.T, count)
    rows = np.arange(count - 3)
    penalty = _banded(
        [rows + number for number in range(4)], np.outer(third, np.ones(count - 3)), count
    )
    speeds = np.diff(values, axis=0) / np.diff(seconds)[:, None]
    floor = late_s**2 / 12 * np.mean(speeds**2, axis=0)  # variance of a uniform delay, times speed
    # The stiffness is chosen over the first 300 knots: a long recording has the same throughout.
    window = min(cells, 300)
    early = places <= window
    size = window + _DEGREE
    inner = np.diff(np.eye(size), 3, axis=0)  # a difference cut off would pull to 0
    # In the basis that makes both matrices diagonal (Demmler and Reinsch 1975) a stiffness only
    # shrinks each coordinate: all of them are compared at the cost of one.
    weights = np.logspace(-9, 7, 65)  # from interpolation to a parabola, four a decade
    first_cell, first_basis = even_basis(places[early], window)
    shown, seen = np.zeros((len(first_cell), size)), values[early]
    np.put_along_axis(shown, first_cell[:, None] + np.arange(_DEGREE + 1), first_basis, axis=1)
    first_penalty = inner.T @ inner
    powers, basis = eigh(first_penalty, shown.T @ shown + _RIDGE * first_penalty)
    powers = np.maximum(powers, 0.0)
    amounts = (shown @ basis).T @ seen
    shrinkage = 1 / (1 + weights[:, None] * powers)
    squares = np.sum(seen**2, axis=0) - 2 * shrinkage @ amounts**2 + shrinkage**2 @ amounts**2
    # A degree of freedom costs 1.4: with 1, cross-validation follows noise too often (Gu 2002).
    freedom = len(seen) - 1.4 * shrinkage.sum(axis=1)
    scores = np.maximum(squares, 0.0) / np.maximum(freedom, 1e-3)[:, None] ** 2
    scores[freedom <= 0] = np.inf
    variance = squares / np.maximum(len(seen) - shrinkage.sum(axis=1), 1.0)[:, None]
    scores[(variance < floor) & (variance < variance[-1])] = np.inf
    stiffnesses = weights[np.argmin(scores, axis=0)]
    coefficients = np.empty((count, values.shape[1]))
    for column, stiffness in enumerate(stiffnesses.tolist()):
        right = np.zeros(count)
        for number, one in enumerate(design.T):
            right += np.bincount(cell + number, one * values[:, column], count)
        both = normal + (stiffness + _RIDGE) * penalty
        coefficients[:, column] = solve_banded((_DEGREE, _DEGREE), both, right, overwrite_ab=True)
    return EvenSpline(float(seconds[0]), step, coefficients)


def _banded(columns: Sequence[NDArray[np.intp]], values: Array, count: int) -> Array:
    """Return A^T A of rows with few values beside each other, as bands for LAPACK, (11, count).

    Of the rows' first, second, ... the columns, and the values, shape (N, R).
    """
    bands = np.zeros((2 * _DEGREE + 1, count))
    for off in range(len(values)):
        for number in range(len(values) - off):
            both = values[number] * values[number + off]
            bands[_DEGREE + off] += np.bincount(columns[number], both, count)
        if off:
            bands[_DEGREE - off, off:] = bands[_DEGREE + off, :-off]
    return bands


# ---- Terms beside the model's, with priors in groups of one scale each
# Sizes are fractions of each joint's rated torque, so that a wrist and a shoulder, a desk's arm and
# a factory's, have the same table. The log decides on the scale of a group (`noise.py`).

# Mass [kg], first moments [kg·m] (3), and what the inertia is more than a ball's [kg·m²] (6).
PAYLOAD_TERMS = 10
MASS = 0
CENTRE = slice(1, 4)
INERTIA = slice(4, 10)
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
# Of the highest torque of the joint that works hardest: where no log comes near it, the limits of a
# description are nobody's.
_MIN_LOAD = 0.25


@dataclass(frozen=True, eq=False)
class Terms:
    """Unknowns of some runs of one arm, the payload's first; those of one joint are together."""

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
    numbers, axes = range(1, len(arm.joints) + 1), ("x", "y", "z")
    arm_kg = sum(joint.link.mass_kg for joint in arm.joints)
    reach_m = sum(float(np.linalg.norm(joint.origin_m)) for joint in arm.joints)
    table: list[tuple[str, str, float]] = [
        ("payload", "payload", arm_kg),
        # Of a kilogram: where in a hand its centre may be [m], how long it may be [m²].
        *((f"centre {axis}", "centre", 0.05) for axis in axes),
        *((f"inertia {axis}", "inertia", 0.003) for axis in ("xx", "xy", "yy", "xz", "yz", "zz")),
        # Errors of the arm's description: fractions, and of a centre for an arm of 1 m.
        *((f"mass of link {n}", "links", 0.04) for n in numbers),
        *(
            (f"centre {axis} of link {n}", "links", 0.003 * reach_m)
            for n in numbers
            for axis in axes
        ),
        *((f"inertia of link {n}", "links", 0.2) for n in numbers),
        # Of a base about each level axis, and of an encoder [rad].
        *((f"tilt of the base about {axis}", "tilt", 0.01) for axis in axes[:2]),
        *((f"zero of encoder {n}", "zeros", 0.005) for n in numbers),
    ]
    slow, load, pull = "friction at low speed", "friction under load", "hoses and gears"
    scaled = list(zip(numbers, scales_nm.tolist(), strict=True))
    for n, scale_nm in scaled:  # in the order of `_BESIDE` and the indices before it
        sizes_nm = {what: size * scale_nm for what, size in _SIZES.items()}
        own = [
            ("offset", "offset", sizes_nm["offset"]),
            ("viscous friction", "friction", sizes_nm["viscous friction"]),
            ("dry friction", "friction", sizes_nm["dry friction"]),
            *((f"{slow} ({shape})", slow, sizes_nm[slow]) for shape in range(1, SHAPES + 1)),
            (load, load, _SIZES[load]),
            ("rotor", "rotor", sizes_nm["rotor"]),
            ("gain", "gain", gain),
            *(
                (f"hoses and gear ({turn} {wave})", pull, sizes_nm[pull] / wave)
                for wave in range(1, WAVES + 1)
                for turn in ("cos", "sin")
            ),
        ]
        table += [(f"{what} of joint {n}", group, size) for what, group, size in own]
    for run in range(runs):
        of = "" if run == 0 else f" of tare {run}" if runs > 2 else " of the tare"
        table.append((f"lag{of}", "lag", 0.02))  # of torques behind positions [s]
        for what, is_there in (("drift", drifts), ("warming", True)):
            table += [
                (f"{what} of joint {n}{of}", what, _SIZES[what] * scale_nm * is_there)
                for n, scale_nm in scaled
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
# Of one joint: offset, viscous and dry friction, its shapes, load, rotor, gain, waves.
OWN_TERMS = 6 + SHAPES + 2 * WAVES


# ---- Torques of a run, rigid and of the joints' own terms, linearised about any values

# Of a joint's own terms: what is a gear's, between the arm and the sensor; and what is not.
_LOAD_WAY, _LOAD, _GAIN = 2, 7, 9
_GEAR = slice(1, 9)
_BESIDE = [0, *range(10, OWN_TERMS)]


@dataclass(frozen=True)
class Convention:
    """Torque convention of a driver."""

    sign: int  # +1 if it is the joint's torque, -1 if it is the load's
    has_gravity: bool  # whether the arm's own weight is included


CONVENTIONS = tuple(Convention(sign, full) for full in (True, False) for sign in (1, -1))


class RigidTorques(NamedTuple):
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
        # Of one body in Pinocchio: mass, first moments (3), and the inertia about the joint's frame
        # as xx, xy, yy, xz, yz, zz, which is its lower triangle by rows.
        parameters = np.zeros((10, PAYLOAD_TERMS))
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
        compute = self._library.computeGeneralizedGravity
        return np.stack([compute(self._model, self._data, row).copy() for row in position])

    def torques(
        self, position: Array, velocity: Array, acceleration: Array, values: Array, *, held: bool
    ) -> RigidTorques:
        """Compute torques along a motion, (T, J), and their slopes by the terms (regressor)."""
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
        regressor = np.stack(regressors).reshape(*position.shape, count, 10)
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
            held_nm = [
                library.computeGeneralizedGravity(model, data, row).copy() for row in position
            ]
            slopes[..., at + axis] = np.stack(held_nm)
        slopes[..., at + 2 :] = np.stack(by_angle)
        return RigidTorques(np.einsum("tjlp,lp->tj", regressor, bodies), slopes)

    def _become(self, bodies: Array, tilt: Array) -> None:
        """Set the links' parameters, shape (J, 10), and the tilt of gravity, shape (2,)."""
        down = -np.sqrt(max(1.0 - float(tilt @ tilt), 0.0))
        self._model.gravity.linear = GRAVITY_M_S2 * np.array([*tilt, down])
        for index, body in enumerate(bodies, 1):
            own = body.copy()
            # A link's mass [kg], whatever a fit makes of it on its way
            own[0] = max(own[0], 1e-6)
            self._model.inertias[index] = self._library.Inertia.FromDynamicParameters(own)


def moments() -> Array:
    """Return the unit tensors of the six moments of inertia, in order, shape (6, 3, 3)."""
    each, (rows, columns), tensors = np.arange(6), np.tril_indices(3), np.zeros((6, 3, 3))
    tensors[each, rows, columns] = tensors[each, columns, rows] = 1.0
    return tensors


@dataclass(frozen=True, eq=False)
class Linearization:
    """Torques linearised about some values of the terms."""

    predicted_nm: Array  # at these values [N·m], shape (T, J)
    columns: NDArray[np.int64]  # terms that each joint's slopes are by, shape (J, C)
    slopes: Array  # derivatives, shape (T, J, C)


@dataclass(frozen=True, eq=False)
class LoggedArm:
    """Torque model of one run."""

    model: ArmModel  # the arm's
    terms: Terms  # of all runs that are fitted together
    motion: ArmMotion  # this one's
    run: int  # 0 for the log itself, from 1 for its tares
    # for a tare along the log's path, which of the log's times it covers; None for any other run
    covered: NDArray[np.bool_] | None = None

    def linearized(self, values: Array, convention: Convention) -> Linearization:
        """Linearise the torques about values of the terms, shape (N,)."""
        joints, seconds = self.terms.joints, self.motion.seconds
        # The terms that each joint's torques depend on, shape (J, C): first what all joints share,
        # the lag last of it; then the joint's own; then its drifts.
        common = np.arange(PAYLOAD_TERMS + 6 * joints + 2)
        own = len(common) + np.arange(joints)[:, None] * OWN_TERMS + np.arange(OWN_TERMS)
        lag = len(common) + joints * OWN_TERMS + self.run * (1 + 2 * joints)
        drifts = lag + 1 + np.arange(joints)[:, None] + joints * np.arange(2)
        columns = np.hstack([np.tile(np.append(common, lag), (joints, 1)), own, drifts])

        first = columns.shape[1] - OWN_TERMS - 2
        of_joint = values[columns[:, first : first + OWN_TERMS]]
        zeros = values[first - 1 - joints : first - 1]
        said, velocity, acceleration = self.motion.at(seconds - values[columns[0, first - 1]])
        rigid = self.model.torques(said + zeros, velocity, acceleration, values, held=self.run == 0)
        # The regressors of the joints' own terms, (T, J, OWN_TERMS); gains are 0. The sign of a
        # velocity is smoothed about 0, which is known to .015 rad/s; Stribeck's widths, over which
        # friction falls from its peak, are between these [rad/s].
        way = np.tanh(velocity / 0.015)
        slow = [way * np.exp(-((velocity / width) ** 2)) for width in (0.03, 0.1, 0.3)]
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
