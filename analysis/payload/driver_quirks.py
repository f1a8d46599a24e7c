"""Undo habits of robot drivers: joint names, degrees, wrapped angles, repeated samples."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from operator import eq

import numpy as np
from numpy.typing import NDArray

from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.terminal import FEW_NAMES, listed, short_name

# Names that end in a number too, but not in that of a joint of the arm.
_NOT_OF_THE_ARM = re.compile(r"finger|gripper|knuckle|thumb|wheel", re.I)

# A joint's name that says no more than its number: a driver's other topic may give it.
_GENERIC = re.compile(r"(?:joint|axis|j|a)?[_\- .]*(\d+)", re.I)

_TURN_RAD = 2 * np.pi

_SLACK_RAD = 0.3
# An angle further beyond its joint's limits, or of more turns, is odd: calibration explains less,
# and few joints turn more than twice.
_MAX_TURNS = 2.1

_DEGREES_SHARE = 1 / 3  # of the joints that turn: as many have odd angles where they are in degrees
# A speed over this multiple of its joint's limit, or over this one, is odd: no arm reaches it.
_LIMIT_FACTOR, _MAX_SPEED_RAD_S = 3.0, 15.0

# A tenth of the samples must be odd: fewer are glitches.
_FAST_QUANTILE, _BEYOND_FRACTION = 0.9, 0.1

# Ticks and clock in turn; the ticks of a regular driver stay the same after two or three.
_CLOCK_ITERATIONS = 5

_MAX_OUTSIDE = 0.05
# Fraction of the samples that may lie outside of their messages, beyond this fraction of the time
# between two messages: some messages are late.
_CLOCK_SLACK = 0.15

_MAX_TICK_MEDIANS = 3.0  # median times between new samples, from one to the next: more is a rest
_MIN_TICKS = 20  # fewer samples fit an even clock by chance


def match_joints(joints: Sequence[str], columns: Sequence[str]) -> tuple[int, ...]:
    """Match each joint to its column.

    Drivers give a joint several names: `j2s7s300_joint_3`, `left_joint_3`, `joint3`. So names are
    compared whole, then by suffix, then by trailing number. Columns that are only numbered, as many
    as the arm has joints, are its joints from base to tool.

    Args:
        joints: The arm's, base to tool.
        columns: Of a signal; may be more than the arm's, in any order.

    Returns:
        An index into `columns` for each joint.

    Raises:
        NotFoundError: A joint has no column, or several; the message lists what is there.
    """
    for rule in (eq, _is_ending, _is_joint_number, _is_number):
        matches = [[k for k, name in enumerate(columns) if rule(joint, name)] for joint in joints]
        if all(len(indices) == 1 for indices in matches):
            chosen = tuple(indices[0] for indices in matches)
            if len(set(chosen)) == len(chosen):
                return chosen
        if ambiguous := [k for k, indices in enumerate(matches) if len(indices) > 1]:
            first = ambiguous[0]
            names = " and ".join(short_name(columns[index]) for index in matches[first][:2])
            raise NotFoundError(
                f"joint {joints[first]} could be {names}",
                "name an arm whose joints are called as one of them (--urdf FILE --tool-link LINK)",
            )
    found = enumerate(map(_GENERIC.fullmatch, columns))
    numbered = sorted((int(name[1]), k) for k, name in found if name)
    if [number - numbered[0][0] for number, _ in numbered] == list(range(len(joints))):
        return tuple(k for _, k in numbered)
    missing = [
        joint for joint in joints if not any(_is_joint_number(joint, name) for name in columns)
    ]
    there = listed(map(short_name, columns), FEW_NAMES)
    raise NotFoundError(
        f"no joint of the log is {', '.join(missing or joints)} (there: {there})",
        "record all joints of the arm, or name the arm that it is of with --arm NAME, or with "
        "--urdf FILE --tool-link LINK",
    )


def _is_ending(joint: str, name: str) -> bool:
    """Return whether one name is the other's suffix, after a separator."""
    longer, shorter = sorted((name.lower(), joint.lower()), key=len, reverse=True)
    return bool(shorter) and bool(re.search(rf"(^|[^a-z0-9]){re.escape(shorter)}$", longer))


def _is_joint_number(joint: str, name: str) -> bool:
    """Match `joint_3`, `joint3` or `j3` at the end."""
    return _is_numbered(joint, name, r"j(oint)?[ _\-.]*")


def _is_number(joint: str, name: str) -> bool:
    """Match any name that ends in the number."""
    return _is_numbered(joint, name, r"(^|[^0-9])")


def _is_numbered(joint: str, name: str, before: str) -> bool:
    """Match names of one trailing number, the column's after the pattern `before`."""
    number = re.search(r"(?<![0-9])[0-9]{1,9}$", joint)
    if number is None or _NOT_OF_THE_ARM.search(name):
        return False
    return bool(re.search(rf"{before}0*{int(number[0])}$", name, re.I))


def in_newton_metres(effort: Signal, arm: Arm, constants: Sequence[float]) -> Signal:
    """Convert efforts that are currents [A] to torques.

    Args:
        effort: Of all joints, and perhaps of others.
        arm: Whose joints they are.
        constants: Torque constants [N·m/A], one per joint from base to tool, or one for all.

    Raises:
        NotFoundError: There are fewer or more of them; the message says how many are wanted.
    """
    if len(constants) not in (1, len(arm.joints)):
        raise NotFoundError(
            f"--torque-constants has {len(constants)} numbers, the arm {len(arm.joints)} joints: "
            "give one for each from base to tool, or one for all"
        )
    factors = np.ones(len(effort.columns))
    factors[list(match_joints(arm.joint_names, effort.columns))] = constants
    return replace(effort, values=effort.values * factors)


def in_radians(seconds: Array, values: Array, arm: Arm) -> tuple[Array, list[str]]:
    """Convert angles to unwrapped radians, and say what was converted.

    Degrees are detected as radians that put many joints outside their limits, or over many turns. A
    speed that no arm has is no sign of the unit: wrong stamps give it, too, and so does a second
    publisher; nor is one joint whose turns a driver counts.

    Args:
        seconds: Stamps [s], shape (T,).
        values: As the driver gives them, shape (T, J); of a prismatic joint in m.
        arm: Whose they are.

    Returns:
        Angles [rad] (or [m]) without jumps of whole turns, shape (T, J), and remarks.
    """
    turns = np.array([not joint.is_prismatic for joint in arm.joints])
    remarks: list[str] = []
    as_degrees = np.where(turns, np.radians(values), values)
    gone = _misplaced(values, arm) & ~_misplaced(as_degrees, arm)
    if np.count_nonzero(gone) >= max(1, _DEGREES_SHARE * np.count_nonzero(turns)):
        values = as_degrees
        remarks.append("the joints' positions are in degrees: converted")
    elif gone.any():
        joint = arm.joints[int(gone.argmax())].name
        remarks.append(
            f"positions of {joint} are more than it turns, if they are rad, those of most joints "
            "are not: taken as rad; if the driver gives degrees, convert them first"
        )
    elif np.count_nonzero(_too_fast(seconds, values, arm) & ~_too_fast(seconds, as_degrees, arm)):
        remarks.append(
            "joints are faster than any arm: bad stamps, two publishers on one topic, or degrees; "
            "the positions are taken as rad"
        )
    whole = np.where(turns, np.unwrap(values, period=_TURN_RAD, axis=0), values)
    if not np.allclose(whole, values):
        remarks.append("the joints' positions are cut to one turn: joined")
    for column, joint in enumerate(arm.joints):
        middle = sum(joint.limits_rad) / 2
        if turns[column] and np.isfinite(middle):
            off = float(np.mean(whole[:, column])) - middle
            whole[:, column] -= _TURN_RAD * np.round(off / _TURN_RAD)
    return whole, remarks


def _misplaced(values: Array, arm: Arm) -> NDArray[np.bool_]:
    """Return which joints are where none can be, shape (J,)."""
    found: list[bool] = []
    for joint, column in zip(arm.joints, values.T, strict=True):
        low, high = joint.limits_rad
        is_beyond = bool(np.abs(column).max() > _MAX_TURNS * _TURN_RAD)
        if np.isfinite(high - low) and high - low < _TURN_RAD:
            beyond = np.mod(column - low + _SLACK_RAD, _TURN_RAD) > high - low + 2 * _SLACK_RAD
            is_beyond |= bool(np.mean(beyond) > _BEYOND_FRACTION)
        found.append(is_beyond and not joint.is_prismatic)
    return np.array(found)


def _too_fast(seconds: Array, values: Array, arm: Arm) -> NDArray[np.bool_]:
    """Return which joints are faster than any can be, shape (J,)."""
    steps = np.diff(values, axis=0)
    steps -= _TURN_RAD * np.round(steps / _TURN_RAD)
    speeds = np.quantile(np.abs(steps) / np.diff(seconds)[:, None], _FAST_QUANTILE, axis=0)
    fastest = [min(_LIMIT_FACTOR * one.max_velocity_rad_s, _MAX_SPEED_RAD_S) for one in arm.joints]
    turns = np.array([not joint.is_prismatic for joint in arm.joints])
    return turns & (speeds > np.array(fastest))


def even_clock(before: Array, seconds: Array) -> tuple[Array, float] | None:
    """Fit a uniform clock to the times at which samples were measured; None if none fits.

    A driver that publishes faster than it measures repeats samples. One that is new in a message
    was measured some time since the message before. If all that fits one uniform clock (fitted by
    alternating least squares: the nearest tick of each sample, then a line through the ticks), it
    gives far better stamps than the messages do: their beat with it would look like a tremor. While
    the arm rests, no sample is new for many ticks.

    Args:
        before: Time of the message before each new sample's [s], shape (T,); the first has none.
        seconds: Time of the message that shows it first [s], shape (T,).

    Returns:
        Times [s], shape (T,), and the clock's period [s].
    """
    if len(seconds) < _MIN_TICKS:
        return None
    begins, ends = before[1:], seconds[1:]
    middles = (begins + ends) / 2
    steps = np.diff(middles)
    usual = steps[steps <= _MAX_TICK_MEDIANS * np.median(steps)]
    period = float(np.mean(usual))
    rested = np.where(steps <= usual.max(), 1.0, np.round(steps / period))
    ticks = np.cumsum(np.concatenate([[1.0], rested]))
    start = 0.0
    for _ in range(_CLOCK_ITERATIONS):
        period, start = np.polyfit(ticks, middles, 1)
        ticks = np.round((middles - start) / period)
    times = start + period * ticks
    slack = _CLOCK_SLACK * float(np.median(ends - begins))
    outside = (times < begins - slack) | (times > ends + slack)
    if np.any(np.diff(ticks) < 1) or float(np.mean(outside)) > _MAX_OUTSIDE:
        return None
    first = min(np.floor((seconds[0] - start) / period), ticks[0] - 1)
    return np.concatenate([[start + period * first], times]), float(period)


def check_joints(joints: Sequence[str], of_log: Sequence[str]) -> None:
    """Refuse runs of another arm, by the names of its joints, as many as in the log.

    Raises:
        NotFoundError: They differ; generic names match any.
    """
    for other, own in zip(joints, of_log, strict=True):
        if other != own and not (_GENERIC.fullmatch(other) or _GENERIC.fullmatch(own)):
            raise NotFoundError(
                f"its joint {short_name(other)} is {short_name(own)} in the log",
                "name a run of the same arm and driver",
            )
