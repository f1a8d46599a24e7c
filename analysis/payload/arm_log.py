"""Read an arm's log: fresh samples of joint positions, velocities and torques.

Habits of drivers are undone first. A driver publishes faster than it measures, and repeats what it
has: each field keeps only the samples that are new. The arm is the one that the user names, else
that of the log's joint names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from operator import eq
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Array, Episode, LeftOut, Signal, median_step
from tunenet_logs.errors import NotFoundError
from tunenet_logs.reader import check_start, no_topic
from tunenet_logs.recorders.simulators.arm.description import Arm, read_arm
from tunenet_logs.recorders.simulators.arm.known import DEFAULT, arms_called, in_words, known_arm
from tunenet_logs.terminal import FEW_NAMES, listed, short_name
from tunenet_logs.timing.stamps import part_on_grid

# ---- Habits of robot drivers: joint names, degrees, wrapped angles, repeated samples

# Names that end in a number too, but not in that of a joint of the arm.
_NOT_OF_THE_ARM = re.compile(r"finger|gripper|knuckle|thumb|wheel", re.I)
# A joint's name that says no more than its number: a driver's other topic may give it.
_GENERIC = re.compile(r"(?:joint|axis|j|a)?[_\- .]*(\d+)", re.I)
_TURN_RAD = 2 * np.pi


def match_joints(joints: Sequence[str], columns: Sequence[str]) -> tuple[int, ...]:
    """Match each joint to its column.

    Drivers give a joint several names: `j2s7s300_joint_3`, `left_joint_3`, `joint3`. So names are
    compared whole, then by suffix, then by trailing number. Columns that are only numbered, as many
    as the arm has joints, are its joints from base to tool.
    """
    is_joint_number = partial(_is_numbered, before=r"j(oint)?[ _\-.]*")  # joint_3, joint3 or j3
    is_number = partial(_is_numbered, before=r"(^|[^0-9])")
    for rule in (eq, _is_ending, is_joint_number, is_number):
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
    missing = [one for one in joints if not any(is_joint_number(one, name) for name in columns)]
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


def _is_numbered(joint: str, name: str, before: str) -> bool:
    """Match names of one trailing number, the column's after the pattern `before`."""
    number = re.search(r"(?<![0-9])[0-9]{1,9}$", joint)
    if number is None or _NOT_OF_THE_ARM.search(name):
        return False
    return bool(re.search(rf"{before}0*{int(number[0])}$", name, re.I))


def in_radians(seconds: Array, values: Array, arm: Arm) -> tuple[Array, list[str]]:
    """Convert angles to unwrapped radians, and say what was converted.

    Degrees are detected as radians that put many joints outside their limits, or over many turns. A
    speed that no arm has is no sign of the unit: wrong stamps give it, too, and so does a second
    publisher; nor is one joint whose turns a driver counts. `seconds` (T,) [s], `values` (T, J).
    """
    turns = np.array([not joint.is_prismatic for joint in arm.joints])
    remarks: list[str] = []
    as_degrees = np.where(turns, np.radians(values), values)
    (misplaced, fast), (not_gone, still_fast) = (
        _odd_joints(seconds, one, arm) for one in (values, as_degrees)
    )
    gone = misplaced & ~not_gone
    # As many joints have odd angles where they are in degrees.
    if np.count_nonzero(gone) >= max(1, 1 / 3 * np.count_nonzero(turns)):
        values = as_degrees
        remarks.append("the joints' positions are in degrees: converted")
    elif gone.any():
        joint = arm.joints[int(gone.argmax())].name
        remarks.append(
            f"positions of {joint} are more than it turns, if they are rad, those of most joints "
            "are not: taken as rad; if the driver gives degrees, convert them first"
        )
    elif np.count_nonzero(fast & ~still_fast):
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


def _odd_joints(
    seconds: Array, values: Array, arm: Arm
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which joints are where none can be, and which faster than any can be, each (J,)."""
    found: list[bool] = []
    slack_rad = 0.3  # beyond its limits: calibration explains less
    for joint, column in zip(arm.joints, values.T, strict=True):
        low, high = joint.limits_rad
        is_beyond = bool(np.abs(column).max() > 2.1 * _TURN_RAD)  # few joints turn more than twice
        if np.isfinite(high - low) and high - low < _TURN_RAD:
            beyond = np.mod(column - low + slack_rad, _TURN_RAD) > high - low + 2 * slack_rad
            is_beyond |= bool(np.mean(beyond) > 0.1)  # fewer are glitches
        found.append(is_beyond and not joint.is_prismatic)
    steps = np.diff(values, axis=0)
    steps -= _TURN_RAD * np.round(steps / _TURN_RAD)
    speeds = np.quantile(np.abs(steps) / np.diff(seconds)[:, None], 0.9, axis=0)
    # No arm reaches three times its joint's limit, or this speed [rad/s].
    fastest = [min(3.0 * one.max_velocity_rad_s, 15.0) for one in arm.joints]
    turns = np.array([not joint.is_prismatic for joint in arm.joints])
    return np.array(found), turns & (speeds > np.array(fastest))


def even_clock(before: Array, seconds: Array) -> tuple[Array, float] | None:
    """Fit a uniform clock to the times at which samples were measured; None if none fits.

    A driver that publishes faster than it measures repeats samples. One that is new in a message
    was measured some time since the message before. If all that fits one uniform clock (fitted by
    alternating least squares: the nearest tick of each sample, then a line through the ticks), it
    gives far better stamps than the messages do: their beat with it would look like a tremor. While
    the arm rests, no sample is new for many ticks. `before` (T,) [s], `seconds` (T,) [s].
    """
    if len(seconds) < 20:  # fewer samples fit an even clock by chance
        return None
    begins, ends = before[1:], seconds[1:]
    middles = (begins + ends) / 2
    steps = np.diff(middles)
    # Median times between new samples, from one to the next: more is a rest
    usual = steps[steps <= 3.0 * np.median(steps)]
    period = float(np.mean(usual))
    rested = np.where(steps <= usual.max(), 1.0, np.round(steps / period))
    ticks = np.cumsum(np.concatenate([[1.0], rested]))
    start = 0.0
    # Ticks and clock in turn; the ticks of a regular driver stay the same after two or three
    for _ in range(5):
        period, start = np.polyfit(ticks, middles, 1)
        ticks = np.round((middles - start) / period)
    times = start + period * ticks
    # A few messages are late, beyond a share of the time between two.
    slack = 0.15 * float(np.median(ends - begins))
    outside = (times < begins - slack) | (times > ends + slack)
    if np.any(np.diff(ticks) < 1) or float(np.mean(outside)) > 0.05:
        return None
    first = min(np.floor((seconds[0] - start) / period), ticks[0] - 1)
    return np.concatenate([[start + period * first], times]), float(period)


def check_joints(joints: Sequence[str], of_log: Sequence[str]) -> None:
    """Refuse runs of another arm, by the names of its joints, as many as in the log."""
    for other, own in zip(joints, of_log, strict=True):
        if other != own and not (_GENERIC.fullmatch(other) or _GENERIC.fullmatch(own)):
            raise NotFoundError(
                f"its joint {short_name(other)} is {short_name(own)} in the log",
                "name a run of the same arm and driver",
            )


# ---- New samples of a driver, and when they were measured
# Repeats come in runs that end in a step as large as the motion beside them is fast. While the arm
# rests, samples repeat too, but the step after them is small for their time: these count.


@dataclass(frozen=True, eq=False)
class JointSamples:
    """New samples of one field of all joints."""

    topic: str  # where it came from
    seconds: Array  # when each was measured, since the log's first sample [s], (T,), increasing
    values: Array  # shape (T, J), in the arm's order of joints [rad, rad/s or N·m]
    repeated: float  # fraction of recorded samples that only repeat one, rests aside
    late_s: float  # maximum delay from measurement to stamp; 0 if its time is known
    rests: Array  # first and last time of each rest [s], shape (R, 2)

    def __post_init__(self) -> None:
        for array in (self.seconds, self.values, self.rests):
            array.flags.writeable = False

    @property
    def rate_hz(self) -> float:
        """Median rate of new samples [Hz]."""
        return 1 / median_step(self.seconds)


def new_samples(
    seconds: Array, values: Array, rests: Array | None = None, topic: str = ""
) -> JointSamples:
    """Find the new samples of a signal, shape (N, J), and when they were measured.

    `seconds` (N,) [s], `rests` (R, 2) [s] (None if the signal itself shows it: positions do).
    """
    firsts, lengths, still = _runs_of(seconds, values)
    owner = np.repeat(np.arange(len(firsts)), lengths)  # the run of each sample
    stale_runs = np.count_nonzero(lengths[~still] > 1)
    stale = int((lengths[~still] - 1).sum())
    repeated = stale / (stale + len(firsts))
    spans = np.column_stack([seconds[firsts], seconds[firsts + lengths - 1]])
    # Share and number of runs that repeat a sample while the arm moves, from which on a driver
    # publishes faster than it measures: two measured values are equal now and then, a driver is
    # stuck once
    if stale_runs < max(3, 0.03 * len(firsts)):
        keep = still[owner] & _within(seconds, rests)
        keep[firsts] = True
        rows = np.flatnonzero(keep)
        return JointSamples(topic, seconds[rows], values[rows], repeated, 0.0, spans[still])
    begins, before = seconds[firsts], seconds[np.maximum(firsts - 1, 0)]
    lasts = np.diff(np.append(begins, seconds[-1]))
    clock = even_clock(before, begins)
    late_s = 0.0 if clock else median_step(seconds)
    measured, period_s = clock or (begins, float(np.mean(lasts[~still])))
    # What stays the same for longer was measured several times, while the arm rested.
    resting = still & (lasts > 2.5 * period_s)
    ticks = np.floor((seconds - measured[owner]) / period_s).astype(np.int64)
    ticks[firsts] = 0
    is_first = np.diff(ticks, prepend=0) > 0
    times = measured[owner] + period_s * ticks
    behind = np.append(measured[1:], np.inf)[owner]
    keep = resting[owner] & is_first & (ticks > 0) & (times < behind - period_s / 2)
    more, rows = times[keep], np.flatnonzero(keep)
    inside = _within(more, rests)
    times = np.concatenate([measured, more[inside]])
    order = np.argsort(times)
    rows = np.concatenate([firsts, rows[inside]])
    return JointSamples(topic, times[order], values[rows[order]], repeated, late_s, spans[resting])


def _runs_of(
    seconds: Array, values: Array
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Find runs of equal samples: their first ones, their lengths, and which are rests, (R,)."""
    changes = np.any(values[1:] != values[:-1], axis=1)
    begins = np.concatenate([[0], np.flatnonzero(changes) + 1])
    ends = np.append(begins[1:], len(values))
    lengths = ends - begins
    # Remove the jumps of wrapped angles from steps.
    steps = np.diff(values[begins], axis=0)
    turns = np.array([0.0, 2 * np.pi, 360.0])  # in rad or degrees
    nearest = turns[np.argmin([np.abs(np.abs(steps) - turn) for turn in turns], axis=0)]
    steps = steps - np.sign(steps) * nearest
    places = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(steps, axis=0)])
    places = places[np.repeat(np.arange(len(begins)), lengths)]
    # The step after each run: the last one has none.
    after = np.append(np.abs(steps).max(axis=1), 0.0)
    nonzero = np.where(steps == 0, np.inf, np.abs(steps))
    smallest = np.min(nonzero, axis=0, initial=np.inf)
    # A value that changes by less than 1.5 of a joint's smallest change was only rounded meanwhile.
    coarse = np.append(np.all(np.abs(steps) <= 1.5 * smallest, axis=1), True)
    period_s = median_step(seconds)
    # Before and after a run, where its speed is looked for: the longer of both [s]
    reach = max(4, int(np.ceil(0.15 / period_s)))
    left, right = np.maximum(begins - 1, 0), np.minimum(ends, len(values) - 1)
    first, last = np.maximum(left - reach, 0), np.minimum(right + reach, len(values) - 1)
    ways = np.abs(places[left] - places[first]).max(axis=1)
    ways += np.abs(places[last] - places[right]).max(axis=1)
    beside = ways / np.maximum(left - first + last - right, 1)
    # The median of the speeds of all runs, by the way that each makes.
    order = np.argsort(after / lengths)
    sums = np.cumsum(after[order])
    usual = float((after / lengths)[order][np.searchsorted(sums, sums[-1] / 2)])
    # Of the way that the speed beside a run, and that of the whole motion, would make in its
    # time: a step after it that is smaller is none of a motion that went on
    most = lengths * np.maximum(0.4 * beside, 0.1 * usual)
    return begins, lengths, (lengths > 1) & (coarse | (after <= most))


def _within(seconds: Array, rests: Array | None) -> NDArray[np.bool_]:
    """Return whether each time is in one of the rests; all are if none are given."""
    if rests is None or not len(rests):
        return np.full(len(seconds), rests is None)
    at = np.searchsorted(rests[:, 0], seconds, side="right") - 1
    return (at >= 0) & (seconds <= rests[np.maximum(at, 0), 1])


# ---- Samples of all fields, in the arm's order of joints

# Units of the fields that a payload is found from: what has one is of joints, whatever its name.
JOINT_UNITS = ("N·m", "rad")

# In the reason why a channel is not used: it would have been torques.
_TORQUES = re.compile(r"no torques|no measurement|not a measurement")
_MIN_SAMPLES = 20  # of a field: fewer determine neither a motion nor a rate
# Between knots of a spline through positions: no arm's acceleration has finer detail.
MIN_KNOT_S = 0.04
# Of a motion that is fitted, whose torques become a few hundred means: of a longer one they are so
# far apart that a motion which repeats itself looks like a drift.
_MAX_S = 600.0


@dataclass(frozen=True, eq=False)
class ArmLog:
    """Log of an arm."""

    joints: tuple[str, ...]  # names in the log, in the arm's order
    position: JointSamples  # [rad], unwrapped
    velocity: JointSamples | None  # [rad/s] as reported by the driver; None if it is not
    effort: JointSamples  # [N·m] as reported by the driver, in its sign convention
    warnings: tuple[str, ...]  # what was converted or is doubtful
    left_out: tuple[LeftOut, ...] = ()  # samples missing from torques and positions

    @property
    def constant(self) -> NDArray[np.bool_]:
        """Joints whose torque never changes, as no sensor's does, shape (J,)."""
        return np.ptp(self.effort.values, axis=0) == 0


def read_arm_log(
    episode: Episode,
    arm: Arm,
    *,
    topic: str | None = None,  # preferred if several would do; it must have joints of the arm
    start_s: float | None = None,  # since the first sample; None for all
    end_s: float | None = None,
    torque_constants: Sequence[float] = (),  # of currents [N·m/A], one per joint or one for all
) -> ArmLog:
    """Find the joints of an arm in an episode."""
    if topic is not None:  # without the name of one of its fields
        preferred = (one for one in episode.signals_of(topic) if one.unit in JOINT_UNITS)
        named = _with_joints(preferred, arm)
        if named is None:
            usable = (one for one in episode.signals.values() if one.unit in JOINT_UNITS)
            raise no_topic(topic, set(map(_topic, usable)))
        topic = _topic(named)
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
    effort = _measured(effort, arm, torque_constants)
    used = [signal for signal in (effort, position, velocity) if signal is not None]
    first_ns = min(int(signal.stamps_ns[0]) for signal in used)
    last_ns = max(int(signal.stamps_ns[-1]) for signal in used)
    check_start(start_s, (last_ns - first_ns) * 1e-9)
    part = (-np.inf if start_s is None else start_s, np.inf if end_s is None else end_s)
    part, cut = _fitted_part(position, first_ns, part)
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
    # Some minutes of rest between two motions, or so many a sample.
    return max(50_000, 4 * samples)


def _fitted_part(
    position: Signal, first_ns: int, part: tuple[float, float]
) -> tuple[tuple[float, float], list[str]]:
    """Choose the part of a log that is fitted: its first and last time [s], and remarks."""
    seconds = (position.stamps_ns - first_ns).astype(np.float64) * 1e-9
    rows = np.flatnonzero((seconds >= part[0]) & (seconds <= part[1]))
    if len(rows) < _MIN_SAMPLES:
        return part, []
    # It is cut at a pause too long for a spline.
    knot_s = max(median_step(seconds[rows]), MIN_KNOT_S)
    keep, words = part_on_grid(seconds[rows], knot_s * most_knots(len(rows)))
    if words:
        rows = rows[keep[0] : keep[-1] + 1]
        part = float(seconds[rows[0]]), float(seconds[rows[-1]])
    seconds = seconds[rows]
    if len(seconds) < _MIN_SAMPLES or seconds[-1] - seconds[0] <= _MAX_S:
        return part, list(words)
    # Of a long one, that in which the arm moves most.
    step_s = 0.1  # at which it is looked at
    thinned = np.searchsorted(seconds, np.arange(seconds[0], seconds[-1], step_s))
    steps = np.abs(np.diff(position.values[rows[thinned]], axis=0))
    ways = np.concatenate([[0.0], np.cumsum(np.nansum(steps, axis=1))])
    begins = np.arange(seconds[0], seconds[-1] - _MAX_S + step_s, _MAX_S / 10)
    ends = np.minimum(np.searchsorted(seconds[thinned], begins + _MAX_S), len(ways) - 1)
    moved = ways[ends] - ways[np.searchsorted(seconds[thinned], begins)]
    begin = float(begins[np.argmax(moved >= 0.9 * moved.max())])  # the first much alike
    more = (
        f"{seconds[-1] - seconds[0]:.0f} s are more than is fitted at once: the {_MAX_S:.0f} s "
        f"from {begin:.0f} s on, where the arm moves most, are used; name others with --start and "
        "--end"
    )
    return (begin, begin + _MAX_S), [*words, more]


def _with_joints(signals: Iterable[Signal], arm: Arm) -> Signal | None:
    """Return the first signal with all joints, None of none; raise why no one has them."""
    reasons: list[NotFoundError] = []
    for signal in signals:
        try:
            match_joints(arm.joint_names, signal.columns)
        except NotFoundError as error:
            reasons.append(NotFoundError(f"{_topic(signal)}: {error.what}", error.remedy))
        else:
            return signal
    if reasons:
        raise reasons[0]
    return None


def _pick(episode: Episode, unit: str, arm: Arm, topic: str | None, what: str) -> Signal:
    """Pick the signal of that unit with all joints: the preferred topic's, else one that moves."""
    there = [signal for signal in episode.signals.values() if signal.unit == unit]
    if not there:
        # Say why the log's torques, if any, were not used.
        reasons = [
            f"{channel.topic}: {channel.skipped}"
            for channel in episode.channels
            if unit == "N·m" and channel.skipped and _TORQUES.search(channel.skipped)
        ]
        reasons.sort(key=lambda reason: "--torque-constants" not in reason)
        left_out = ": " + "; ".join(reasons[:3]) if reasons else ""
        raise NotFoundError(
            f"no {what} in this log (there: {listed(episode.signals, FEW_NAMES)}){left_out}",
            "record the driver's JointState with position and effort, or its joint_torques topic "
            "beside it",
        )
    is_still: dict[str, bool] = {}
    for signal in there:
        measured = signal.values[:, np.isfinite(signal.values).any(axis=0)]
        finite = measured[np.isfinite(measured).all(axis=1)]
        is_still[signal.name] = not len(finite) or bool(np.all(np.ptp(finite, axis=0) == 0))
    ordered = sorted(there, key=lambda one: (_topic(one) != topic, is_still[one.name]))
    found = _with_joints(ordered, arm)
    assert found is not None
    return found


def _measured(effort: Signal, arm: Arm, constants: Sequence[float]) -> Signal:
    """Return measured torques; 0 for a joint whose torque is never a number.

    Where constants are given [N·m/A], one per joint or one for all, they are currents.
    """
    columns = list(match_joints(arm.joint_names, effort.columns))
    is_measured: NDArray[np.bool_] = np.any(np.isfinite(effort.values), axis=0)
    remedy = "record the topic on which the driver gives measured torques"
    if not is_measured[columns].any():
        raise NotFoundError(f"{_topic(effort)}: no torque is a number: {remedy}")
    effort = replace(effort, values=np.where(is_measured, effort.values, 0.0))
    values = effort.values[:, columns]
    finite = values[np.isfinite(values).all(axis=1)]
    if len(finite) and not np.any(finite):
        raise NotFoundError(f"{_topic(effort)}: every torque is 0: {remedy}")
    if len(finite) and not np.any(np.ptp(finite, axis=0)):
        what = f"{_topic(effort)}: no torque ever changes: the driver was stuck, or measures none"
        raise NotFoundError(what, remedy)
    if not constants:
        return effort
    if len(constants) not in (1, len(arm.joints)):
        raise NotFoundError(
            f"--torque-constants has {len(constants)} numbers, the arm {len(arm.joints)} joints: "
            "give one for each from base to tool, or one for all"
        )
    factors = np.ones(len(effort.columns))
    factors[columns] = constants
    return replace(effort, values=effort.values * factors)


def _fresh(
    signal: Signal,
    arm: Arm,
    first_ns: int,
    part: tuple[float, float],  # first and last time that count [s since `first_ns`]
    rests: Array | None = None,  # of the arm [s], shape (R, 2); None if the signal shows them
) -> JointSamples:
    """Extract the fresh samples of a signal."""
    columns = match_joints(arm.joint_names, signal.columns)
    seconds = (signal.stamps_ns - first_ns).astype(np.float64) * 1e-9
    values = signal.values[:, columns]
    keep = np.isfinite(values).all(axis=1) & (seconds >= part[0]) & (seconds <= part[1])
    seconds, values = seconds[keep], values[keep]
    new = new_samples(seconds, values, rests, _topic(signal)) if len(seconds) > 1 else None
    count = len(seconds) if new is None else len(new.seconds)
    if new is None or count < _MIN_SAMPLES:
        raise NotFoundError(
            f"{signal.name}: {count} samples of all joints are new (wanted: "
            f"{_MIN_SAMPLES} or more): record for 5 s, at the driver's highest rate"
        )
    return new


def _topic(signal: Signal) -> str:
    """Return the signal's topic, without the name of the field."""
    topic, _, field = signal.name.rpartition(".")
    return topic if field in ("position", "velocity", "effort") else signal.name


# ---- Arm of a log: the one that the user names, else by its joint names

_OTHER = "--urdf FILE --tool-link LINK for any other"


def which_arm(
    episode: Episode, named: str | tuple[Path, str] | None, topic: str | None
) -> tuple[Arm, tuple[str, ...]]:
    """Choose the arm of a log, its joints named as there; say why, and what is not known of it.

    The user's arm is a known one's name, or a URDF and the link that holds the payload; without
    one, the topic's joint names go first, else those of torques.
    """
    if isinstance(named, tuple):
        arm = read_arm(*named)
        return arm, arm.remarks
    fields = [signal for signal in episode.signals.values() if signal.unit in JOINT_UNITS]
    wanted = {signal.name for signal in episode.signals_of(topic)} if topic else set()
    fields.sort(key=lambda signal: (signal.name not in wanted, signal.unit != "N·m"))
    there = list(dict.fromkeys(signal.columns for signal in fields))
    known = default = known_arm(DEFAULT)
    why = (
        f"the joints' names do not say which arm this is: taken for a {default.words}; name "
        f"it with --arm, or {_OTHER}"
    )
    said = next((columns for columns in there if arms_called(columns)), None)
    has_torques = any(signal.unit in ("N·m", "A") for signal in episode.signals.values())
    if named is not None:
        known = known_arm(named)
        why = f"arm: {known.words}, as --arm says"
    elif said is not None:  # the usual one of the arms that have these names
        first, *others = called = arms_called(said)
        if first.is_said_by_names:
            variants = f"; with another hand, or none: {in_words(others)}" if others else ""
            known, why = first, f"arm: {first.words}, by its joints' names{variants}"
        elif not _fits(default.joint_names[0], said):
            raise NotFoundError(
                f"its joints are those of {' or '.join(one.words for one in called)}, and their "
                f"names do not say which: add {in_words(called)}, or {_OTHER}"
            )
    elif has_torques and not any(_fits(default.joint_names[0], columns) for columns in there):
        # Joints that are only numbered, one fewer than the default arm has.
        six_joints = tuple(f"joint_{number}" for number in range(1, 7))
        for six in filter(partial(_fits, six_joints), there):
            raise NotFoundError(
                "joints that do not say whose they are "
                f"({listed(map(short_name, six), FEW_NAMES)})",
                f"name the arm with --arm, such as --arm jaco6, or {_OTHER}",
            )
    columns = next((one for one in there if known.names_in(one)), ())
    doubts = (f"arm: {known.doubt}",) if known.doubt else ()
    return known.arm(columns), (why, *doubts)


def _fits(joints: Sequence[str], columns: Sequence[str]) -> bool:
    try:
        match_joints(joints, columns)
    except NotFoundError:
        return False
    return True
