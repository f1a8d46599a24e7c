"""Read an arm's log: fresh samples of joint positions, velocities and torques.

Habits of drivers are undone first. A driver publishes faster than it measures, and repeats what it
has: each field keeps only the samples that are new. The arm is the one that the user names, else
that of the log's joint names.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import eq
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, Episode, LeftOut, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.reader import check_start, no_topic
from tunenet_logs.recorders.simulators.arm.description import Arm, read_arm
from tunenet_logs.recorders.simulators.arm.known import (
    DEFAULT,
    KnownArm,
    arms_called,
    in_words,
    known_arm,
)
from tunenet_logs.terminal import FEW_NAMES, listed, short_name
from tunenet_logs.timing.stamps import part_on_grid

# ---- Habits of robot drivers: joint names, degrees, wrapped angles, repeated samples

# Names that end in a number too, but not in that of a joint of the arm.
_NOT_OF_THE_ARM = re.compile(r"finger|gripper|knuckle|thumb|wheel", re.I)

# A joint's name that says no more than its number: a driver's other topic may give it.
_GENERIC = re.compile(r"(?:joint|axis|j|a)?[_\- .]*(\d+)", re.I)

_TURN_RAD = 2 * np.pi

# An angle further beyond its joint's limits, or of more turns, is odd: calibration explains less,
# and few joints turn more than twice.
_SLACK_RAD = 0.3
_MAX_TURNS = 2.1

_DEGREES_SHARE = 1 / 3  # of the joints that turn: as many have odd angles where they are in degrees
# A speed over this multiple of its joint's limit, or over this one, is odd: no arm reaches it.
_LIMIT_FACTOR, _MAX_SPEED_RAD_S = 3.0, 15.0

# A tenth of the samples must be odd: fewer are glitches.
_FAST_QUANTILE, _BEYOND_FRACTION = 0.9, 0.1

# Ticks and clock in turn; the ticks of a regular driver stay the same after two or three.
_CLOCK_ITERATIONS = 5

# Fraction of the samples that may lie outside of their messages, beyond this fraction of the time
# between two messages: some messages are late.
_MAX_OUTSIDE = 0.05
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


# ---- New samples of a driver, and when they were measured
# Repeats come in runs that end in a step as large as the motion beside them is fast. While the arm
# rests, samples repeat too, but the step after them is small for their time: these count.

# Share and number of runs that repeat a sample while the arm moves, from which on a driver
# publishes faster than it measures: two measured values are equal now and then, a driver is
# stuck once.
_STALE_FRACTION, _MIN_STALE_RUNS = 0.03, 3

# Of the way that the speed beside a run, and that of the whole motion, would make in its time: a
# step after it that is smaller is none of a motion that went on.
_STILL_FRACTION, _SLOW_FRACTION = 0.4, 0.1

# Of the smallest change of a joint: a value that changes by less was only rounded meanwhile.
_COARSE_STEPS = 1.5

# Before and after a run, where its speed is looked for: the longer of both.
_BESIDE_S, _BESIDE_MESSAGES = 0.15, 4

# Of a driver that repeats samples: the same for longer was measured several times.
_REST_PERIODS = 2.5

_TURNS = (0.0, 2 * np.pi, 360.0)  # by which angles jump that are cut to a turn, in rad or degrees


@dataclass(frozen=True, eq=False)
class NewSamples:
    """New samples of a signal.

    Attributes:
        seconds: When each was measured [s], shape (T,), increasing.
        rows: Of the signal, shape (T,).
        repeated: Fraction of recorded samples that only repeat one, rests aside.
        late_s: Maximum delay from measurement to stamp; 0 if its time is known.
        rests: First and last time of each rest [s], shape (R, 2).
    """

    seconds: Array
    rows: NDArray[np.int64]
    repeated: float
    late_s: float
    rests: Array


@dataclass(frozen=True, eq=False)
class _Runs:
    """Runs of equal samples.

    Attributes:
        begins: Index of the first of each, shape (R,).
        ends: Index behind the last of each, shape (R,).
        still: Whether a run of several is of an arm at rest, shape (R,).
    """

    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    still: NDArray[np.bool_]

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Number of samples of each, shape (R,)."""
        return self.ends - self.begins

    @property
    def owner(self) -> NDArray[np.int64]:
        """Index of the run of each sample, shape (N,)."""
        return np.repeat(np.arange(len(self.begins)), self.lengths)


def new_samples(seconds: Array, values: Array, rests: Array | None = None) -> NewSamples:
    """Find the new samples of a signal, and when they were measured.

    Args:
        seconds: Of its messages [s], shape (N,), increasing; two or more.
        values: Shape (N, J).
        rests: When the arm rests [s], shape (R, 2): only then does a value that stays the same
            count. None if the signal itself shows it: positions do.
    """
    runs = _runs_of(seconds, values)
    repeats = runs.lengths - 1
    moving = ~runs.still
    stale_runs = np.count_nonzero(repeats[moving])
    stale = int(repeats[moving].sum())
    repeated = stale / (stale + len(runs.begins))
    if stale_runs < max(_MIN_STALE_RUNS, _STALE_FRACTION * len(runs.begins)):
        owner = runs.owner
        keep = runs.still[owner] & _within(seconds, rests)
        keep[runs.begins] = True
        rows = np.flatnonzero(keep)
        spans = _spans(seconds, runs, runs.still)
        return NewSamples(seconds[rows], rows, repeated, 0.0, spans)
    begins, before = seconds[runs.begins], seconds[np.maximum(runs.begins - 1, 0)]
    lasts = np.diff(np.append(begins, seconds[-1]))
    clock = even_clock(before, begins)
    late_s = 0.0 if clock else float(np.median(np.diff(seconds)))
    measured, period_s = clock or (begins, float(np.mean(lasts[moving])))
    resting = runs.still & (lasts > _REST_PERIODS * period_s)
    more, rows = _in_rests(seconds, runs, resting, measured, period_s)
    inside = _within(more, rests)
    times = np.concatenate([measured, more[inside]])
    order = np.argsort(times)
    rows = np.concatenate([runs.begins, rows[inside]])
    return NewSamples(times[order], rows[order], repeated, late_s, _spans(seconds, runs, resting))


def _runs_of(seconds: Array, values: Array) -> _Runs:
    """Find runs of equal samples, and which of them are rests."""
    changes = np.any(values[1:] != values[:-1], axis=1)
    begins = np.concatenate([[0], np.flatnonzero(changes) + 1])
    ends = np.append(begins[1:], len(values))
    lengths = ends - begins
    steps = _within_a_turn(np.diff(values[begins], axis=0))
    places = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])
    places = places[np.repeat(np.arange(len(begins)), lengths)]
    # The step after each run: the last one has none.
    after = np.append(np.abs(steps).max(axis=1), 0.0)
    nonzero = np.where(steps == 0, np.inf, np.abs(steps))
    smallest = np.min(nonzero, axis=0, initial=np.inf)
    coarse = np.append(np.all(np.abs(steps) <= _COARSE_STEPS * smallest, axis=1), True)
    period_s = float(np.median(np.diff(seconds)))
    reach = max(_BESIDE_MESSAGES, int(np.ceil(_BESIDE_S / period_s)))
    left, right = np.maximum(begins - 1, 0), np.minimum(ends, len(values) - 1)
    first, last = np.maximum(left - reach, 0), np.minimum(right + reach, len(values) - 1)
    ways = np.abs(places[left] - places[first]).max(axis=1)
    ways += np.abs(places[last] - places[right]).max(axis=1)
    beside = ways / np.maximum(left - first + last - right, 1)
    usual = _weighted_median(after / lengths, after)
    most = lengths * np.maximum(_STILL_FRACTION * beside, _SLOW_FRACTION * usual)
    return _Runs(begins, ends, (lengths > 1) & (coarse | (after <= most)))


def _within_a_turn(steps: Array) -> Array:
    """Remove the jumps of wrapped angles from steps."""
    ways = np.stack([np.abs(np.abs(steps) - turn) for turn in _TURNS])
    nearest = np.array(_TURNS)[np.argmin(ways, axis=0)]
    return steps - np.sign(steps) * nearest


def _weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median; 0 without weights."""
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(sums, sums[-1] / 2)])


def _spans(seconds: Array, runs: _Runs, chosen: NDArray[np.bool_]) -> Array:
    """Return first and last time of some runs [s], shape (R, 2)."""
    return np.column_stack([seconds[runs.begins[chosen]], seconds[runs.ends[chosen] - 1]])


def _within(seconds: Array, rests: Array | None) -> NDArray[np.bool_]:
    """Return whether each time is in one of the rests; all are if none are given."""
    if rests is None or not len(rests):
        return np.full(len(seconds), rests is None)
    at = np.searchsorted(rests[:, 0], seconds, side="right") - 1
    return (at >= 0) & (seconds <= rests[np.maximum(at, 0), 1])


def _in_rests(
    seconds: Array,
    runs: _Runs,
    resting: NDArray[np.bool_],
    measured: Array,
    period_s: float,
) -> tuple[Array, NDArray[np.int64]]:
    """Return times [s] and rows that a sample-repeating driver measured while the arm rested.

    Args:
        seconds: Of the messages [s], shape (N,).
        runs: Of equal samples.
        resting: Which of them are rests, shape (R,).
        measured: When the first of each run was measured [s], shape (R,).
        period_s: Between measurements [s].
    """
    owner = runs.owner
    ticks = np.floor((seconds - measured[owner]) / period_s).astype(np.int64)
    ticks[runs.begins] = 0
    is_first = np.diff(ticks, prepend=0) > 0
    times = measured[owner] + period_s * ticks
    behind = np.append(measured[1:], np.inf)[owner]
    keep = resting[owner] & is_first & (ticks > 0) & (times < behind - period_s / 2)
    return times[keep], np.flatnonzero(keep)


# ---- Samples of all fields, in the arm's order of joints

# Units of the fields that a payload is found from: what has one is of joints, whatever its name.
JOINT_UNITS = ("N·m", "rad")

# What to do where there are no torques.
_RECORD_REMEDY = (
    "record the driver's JointState with position and effort, or its joint_torques topic beside it"
)

# In the reason why a channel is not used: it would have been torques.
_TORQUES = re.compile(r"no torques|no measurement|not a measurement")

_MAX_REASONS = 3  # channels of which a refusal says why they are not used
_MIN_SAMPLES = 20  # of a field: fewer determine neither a motion nor a rate
# Between knots of a spline through positions: no arm's acceleration has finer detail.
MIN_KNOT_S = 0.04

# Of a motion that is fitted, whose torques become a few hundred means: of a longer one they are so
# far apart that a motion which repeats itself looks like a drift. How often it is looked at to find
# where it moves most, and parts that move as much as this fraction of the most.
_MAX_S, _LOOKED_AT_S, _MUCH_ALIKE = 600.0, 0.1, 0.9

# Of a spline through positions: some minutes of rest between two motions, or so many a sample.
_KNOTS, _KNOTS_A_SAMPLE = 50_000, 4


@dataclass(frozen=True, eq=False)
class JointSamples:
    """Fresh samples of one field of all joints.

    Attributes:
        topic: Where it came from.
        seconds: Since the log's first sample [s], shape (T,), increasing.
        values: Shape (T, J), in the arm's order of joints [rad, rad/s or N·m].
        repeated: Fraction of recorded samples that only repeat one, rests aside.
        late_s: Maximum delay from measurement to stamp; 0 if its time is known.
        rests: First and last time of each rest [s], shape (R, 2).
    """

    topic: str
    seconds: Array
    values: Array
    repeated: float
    late_s: float
    rests: Array

    def __post_init__(self) -> None:
        for array in (self.seconds, self.values, self.rests):
            array.flags.writeable = False

    @property
    def rate_hz(self) -> float:
        """Median rate of fresh samples [Hz]."""
        return 1 / float(np.median(np.diff(self.seconds)))


@dataclass(frozen=True, eq=False)
class ArmLog:
    """Log of an arm.

    Attributes:
        joints: Names in the log, in the arm's order.
        position: [rad], unwrapped.
        velocity: [rad/s] as reported by the driver; None if it is not.
        effort: [N·m] as reported by the driver, in its sign convention.
        warnings: What was converted or is doubtful.
        left_out: Samples missing from torques and positions.
    """

    joints: tuple[str, ...]
    position: JointSamples
    velocity: JointSamples | None
    effort: JointSamples
    warnings: tuple[str, ...]
    left_out: tuple[LeftOut, ...] = ()

    @property
    def constant(self) -> NDArray[np.bool_]:
        """Joints whose torque never changes, as no sensor's does, shape (J,)."""
        return np.ptp(self.effort.values, axis=0) == 0


def read_arm_log(
    episode: Episode,
    arm: Arm,
    *,
    topic: str | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    torque_constants: Sequence[float] = (),
) -> ArmLog:
    """Find the joints of an arm in an episode.

    Args:
        episode: A log's.
        arm: Whose joints are looked for.
        topic: Preferred if several would do; it must have joints of the arm.
        start_s: Where to begin [s since the first sample]; None for there.
        end_s: Where to end [s since the first sample]; None for the last.
        torque_constants: For efforts that are currents [N·m/A], one per joint or one for all.

    Raises:
        NotFoundError: There are no torques, no such joints or topic, or too few samples.
    """
    if topic is not None:
        topic = _checked_topic(episode, arm, topic)
    if torque_constants and "N·m" not in {signal.unit for signal in episode.signals.values()}:
        raise NotFoundError(
            f"no efforts to take as currents (there: {listed(episode.signals, FEW_NAMES)})",
            "leave --effort-unit out (--torque-constants alone is for a table's currents)",
        )
    effort = _pick(episode, "N·m", arm, topic, "joint torques")
    in_topic = [signal.unit for signal in episode.signals.values() if _topic(signal) == topic]
    prefer = topic if topic and "rad" in in_topic else _topic(effort)
    position = _pick(episode, "rad", arm, prefer, "joint positions")
    velocity = velocities = None  # only checked against the positions: a log can do without
    with suppress(NotFoundError):
        velocity = _pick(episode, "rad/s", arm, _topic(position), "joint velocities")
    effort = _measured(effort, arm)
    if torque_constants:  # as stated: a JointState does not say its unit
        effort = in_newton_metres(effort, arm, torque_constants)
    used = [signal for signal in (effort, position, velocity) if signal is not None]
    first_ns = min(int(signal.stamps_ns[0]) for signal in used)
    last_ns = max(int(signal.stamps_ns[-1]) for signal in used)
    check_start(start_s, (last_ns - first_ns) * 1e-9)
    part = (-np.inf if start_s is None else start_s, np.inf if end_s is None else end_s)
    part, cut = _bounded(position, first_ns, part)
    part, more = _busiest(position, first_ns, part)
    cut += more
    try:
        positions = _fresh(position, arm, first_ns, part)
        if velocity is not None:
            with suppress(NotFoundError):
                velocities = _fresh(velocity, arm, first_ns, part)
        efforts = _fresh(effort, arm, first_ns, part, positions.rests)
    except NotFoundError as error:
        raise NotFoundError("; ".join((error.what, *cut)), error.remedy) from error
    angles, remarks = in_radians(positions.seconds, positions.values, arm)
    columns = match_joints(arm.joint_names, effort.columns)
    return ArmLog(
        joints=tuple(effort.columns[column] for column in columns),
        position=replace(positions, values=angles),
        velocity=velocities,
        effort=efforts,
        warnings=(*remarks, *cut),
        left_out=(LeftOut.of_signal(effort), LeftOut.of_signal(position)),
    )


def most_knots(samples: int) -> int:
    """Bound the knots of a spline through so many positions, independent of their stamps."""
    return max(_KNOTS, _KNOTS_A_SAMPLE * samples)


def _bounded(
    position: Signal, first_ns: int, part: tuple[float, float]
) -> tuple[tuple[float, float], list[str]]:
    """Cut a log at a pause too long for a spline; return first and last time, and remarks."""
    seconds = (position.stamps_ns - first_ns).astype(np.float64) * 1e-9
    seconds = seconds[(seconds >= part[0]) & (seconds <= part[1])]
    if len(seconds) < _MIN_SAMPLES:
        return part, []
    knot_s = max(float(np.median(np.diff(seconds))), MIN_KNOT_S)
    keep, words = part_on_grid(seconds, knot_s * most_knots(len(seconds)))
    if not words:
        return part, []
    return (float(seconds[keep[0]]), float(seconds[keep[-1]])), list(words)


def _busiest(
    position: Signal, first_ns: int, part: tuple[float, float]
) -> tuple[tuple[float, float], list[str]]:
    """Return the `_MAX_S` of a long log in which the arm moves most, and remarks."""
    seconds = (position.stamps_ns - first_ns).astype(np.float64) * 1e-9
    rows = np.flatnonzero((seconds >= part[0]) & (seconds <= part[1]))
    seconds = seconds[rows]
    if len(seconds) < _MIN_SAMPLES or seconds[-1] - seconds[0] <= _MAX_S:
        return part, []
    thinned = np.searchsorted(seconds, np.arange(seconds[0], seconds[-1], _LOOKED_AT_S))
    steps = np.abs(np.diff(position.values[rows[thinned]], axis=0))
    ways = np.concatenate([[0.0], np.cumsum(np.nansum(steps, axis=1))])
    begins = np.arange(seconds[0], seconds[-1] - _MAX_S + _LOOKED_AT_S, _MAX_S / 10)
    ends = np.minimum(np.searchsorted(seconds[thinned], begins + _MAX_S), len(ways) - 1)
    moved = ways[ends] - ways[np.searchsorted(seconds[thinned], begins)]
    begin = float(begins[np.argmax(moved >= _MUCH_ALIKE * moved.max())])
    words = (
        f"{seconds[-1] - seconds[0]:.0f} s are more than is fitted at once: the {_MAX_S:.0f} s "
        f"from {begin:.0f} s on, where the arm moves most, are used; name others with --start and "
        "--end"
    )
    return (begin, begin + _MAX_S), [words]


def _checked_topic(episode: Episode, arm: Arm, topic: str) -> str:
    """Return the topic that a user named, without the name of one of its fields.

    Raises:
        NotFoundError: It has no joints, or none of them is the arm's.
    """
    reasons: list[NotFoundError] = []
    for signal in episode.signals_of(topic):
        if signal.unit not in JOINT_UNITS:
            continue
        try:
            match_joints(arm.joint_names, signal.columns)
        except NotFoundError as error:
            reasons.append(NotFoundError(f"{_topic(signal)}: {error.what}", error.remedy))
        else:
            return _topic(signal)
    if reasons:
        raise reasons[0]
    usable = {_topic(signal) for signal in episode.signals.values() if signal.unit in JOINT_UNITS}
    raise no_topic(topic, usable)


def _pick(episode: Episode, unit: str, arm: Arm, topic: str | None, what: str) -> Signal:
    """Pick the signal of that unit with all joints: the preferred topic's, else one that moves."""
    there = [signal for signal in episode.signals.values() if signal.unit == unit]
    if not there:
        left_out = _left_out(episode, unit)
        raise NotFoundError(
            f"no {what} in this log (there: {listed(episode.signals, FEW_NAMES)}){left_out}",
            _RECORD_REMEDY,
        )
    is_still: dict[str, bool] = {}
    for signal in there:
        measured = signal.values[:, np.isfinite(signal.values).any(axis=0)]
        finite = measured[np.isfinite(measured).all(axis=1)]
        is_still[signal.name] = not len(finite) or bool(np.all(np.ptp(finite, axis=0) == 0))
    reasons: list[NotFoundError] = []
    for signal in sorted(
        there, key=lambda signal: (_topic(signal) != topic, is_still[signal.name])
    ):
        try:
            match_joints(arm.joint_names, signal.columns)
        except NotFoundError as error:
            reasons.append(NotFoundError(f"{_topic(signal)}: {error.what}", error.remedy))
        else:
            return signal
    raise reasons[0]


def _left_out(episode: Episode, unit: str) -> str:
    """Say why the log's torques, if any, were not used."""
    reasons = [
        f"{channel.topic}: {channel.skipped}"
        for channel in episode.channels
        if unit == "N·m" and channel.skipped and _TORQUES.search(channel.skipped)
    ]
    reasons.sort(key=lambda reason: "--torque-constants" not in reason)
    return ": " + "; ".join(reasons[:_MAX_REASONS]) if reasons else ""


def _measured(effort: Signal, arm: Arm) -> Signal:
    """Return measured torques; 0 for a joint whose torque is never a number.

    Raises:
        NotFoundError: No sensor gives these.
    """
    columns = match_joints(arm.joint_names, effort.columns)
    is_measured: NDArray[np.bool_] = np.any(np.isfinite(effort.values), axis=0)
    if not is_measured[list(columns)].any():
        raise NotFoundError(
            f"{_topic(effort)}: no torque is a number: record the topic on which the driver gives "
            "measured torques"
        )
    effort = replace(effort, values=np.where(is_measured, effort.values, 0.0))
    values = effort.values[:, columns]
    finite = values[np.isfinite(values).all(axis=1)]
    if len(finite) and not np.any(finite):
        raise NotFoundError(
            f"{_topic(effort)}: every torque is 0: record the topic on which the driver gives "
            "measured torques"
        )
    if len(finite) and not np.any(np.ptp(finite, axis=0)):
        raise NotFoundError(
            f"{_topic(effort)}: no torque ever changes: the driver was stuck, or measures none",
            "record the topic on which the driver gives measured torques",
        )
    return effort


def _fresh(
    signal: Signal,
    arm: Arm,
    first_ns: int,
    part: tuple[float, float],
    rests: Array | None = None,
) -> JointSamples:
    """Extract the fresh samples of a signal.

    Args:
        signal: Of one field.
        arm: Whose joints.
        first_ns: Stamp of the log's first sample.
        part: First and last time that count [s since `first_ns`].
        rests: When the arm rests [s], shape (R, 2); None if the signal itself shows it.

    Raises:
        NotFoundError: They are too few.
    """
    columns = match_joints(arm.joint_names, signal.columns)
    seconds = (signal.stamps_ns - first_ns).astype(np.float64) * 1e-9
    values = signal.values[:, columns]
    keep = np.isfinite(values).all(axis=1) & (seconds >= part[0]) & (seconds <= part[1])
    seconds, values = seconds[keep], values[keep]
    new = new_samples(seconds, values, rests) if len(seconds) > 1 else None
    count = len(seconds) if new is None else len(new.rows)
    if new is None or count < _MIN_SAMPLES:
        raise NotFoundError(
            f"{signal.name}: {count} samples of all joints are new (wanted: "
            f"{_MIN_SAMPLES} or more): record for 5 s, at the driver's highest rate"
        )
    return JointSamples(
        _topic(signal), new.seconds, values[new.rows], new.repeated, new.late_s, new.rests
    )


def _topic(signal: Signal) -> str:
    """Return the signal's topic, without the name of the field."""
    for ending in (".position", ".velocity", ".effort"):
        if signal.name.endswith(ending):
            return signal.name.removesuffix(ending)
    return signal.name


# ---- Arm of a log: the one that the user names, else by its joint names

# Joints that are only numbered, one fewer than the default arm has.
_SIX = tuple(f"joint_{number}" for number in range(1, 7))

_OTHER = "--urdf FILE --tool-link LINK for any other"


@dataclass(frozen=True)
class ChosenArm:
    """Arm that a log is taken to be of.

    Attributes:
        arm: Its joints named as in the log, if its drivers have several names for them.
        remarks: Why this one, and what is not known of it.
    """

    arm: Arm
    remarks: tuple[str, ...]


def which_arm(
    episode: Episode, named: str | tuple[Path, str] | None, topic: str | None
) -> ChosenArm:
    """Choose the arm of a log.

    Args:
        episode: The log's.
        named: A known arm's name, or a URDF and the link that holds the payload; None if the user
            names none.
        topic: Channel to go by; None for all, those with torques first.

    Raises:
        UsageError: The name is no arm's, or the URDF is invalid.
        NotFoundError: No arm is named, and it could be several, none of them the default.
    """
    if isinstance(named, tuple):
        arm = read_arm(*named)
        return ChosenArm(arm, arm.remarks)
    there = _columns(episode, topic)
    if named is not None:
        known = known_arm(named)
        return _chosen(known, there, f"arm: {known.words}, as --arm says")
    for columns in there:
        if called := arms_called(columns):
            return _by_names(called, columns, there)
    seven = known_arm(DEFAULT).joint_names[0]
    has_torques = any(signal.unit in ("N·m", "A") for signal in episode.signals.values())
    if has_torques and not any(_fits(seven, columns) for columns in there):
        for columns in there:
            if _fits(_SIX, columns):
                raise NotFoundError(
                    "joints that do not say whose they are "
                    f"({listed(map(short_name, columns), FEW_NAMES)})",
                    f"name the arm with --arm, such as --arm jaco6, or {_OTHER}",
                )
    return _default(there)


def _by_names(
    called: tuple[KnownArm, ...], columns: Sequence[str], there: Sequence[Sequence[str]]
) -> ChosenArm:
    """Choose the usual one of the arms that have these names."""
    first, *others = called
    if first.is_said_by_names:
        variants = f"; with another hand, or none: {in_words(others)}" if others else ""
        return _chosen(first, there, f"arm: {first.words}, by its joints' names{variants}")
    if _fits(known_arm(DEFAULT).joint_names[0], columns):
        return _default(there)
    raise NotFoundError(
        f"its joints are those of {' or '.join(one.words for one in called)}, and their names do "
        f"not say which: add {in_words(called)}, or {_OTHER}"
    )


def _default(there: Sequence[Sequence[str]]) -> ChosenArm:
    known = known_arm(DEFAULT)
    return _chosen(
        known,
        there,
        f"the joints' names do not say which arm this is: taken for a {known.words}; name "
        f"it with --arm, or {_OTHER}",
    )


def _chosen(known: KnownArm, there: Sequence[Sequence[str]], why: str) -> ChosenArm:
    """Build a known arm, its joints named as the columns that have all of them."""
    columns = next((one for one in there if known.names_in(one)), ())
    doubts = (f"arm: {known.doubt}",) if known.doubt else ()
    return ChosenArm(known.arm(columns), (why, *doubts))


def _columns(episode: Episode, topic: str | None) -> list[tuple[str, ...]]:
    """List the joint names of each field, the preferred topic's and those of torques first."""
    fields = [signal for signal in episode.signals.values() if signal.unit in JOINT_UNITS]
    wanted = {signal.name for signal in episode.signals_of(topic)} if topic else set()
    fields.sort(key=lambda signal: (signal.name not in wanted, signal.unit != "N·m"))
    return list(dict.fromkeys(signal.columns for signal in fields))


def _fits(joints: Sequence[str], columns: Sequence[str]) -> bool:
    try:
        match_joints(joints, columns)
    except NotFoundError:
        return False
    return True
