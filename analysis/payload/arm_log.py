"""Read an arm's log: fresh samples of joint positions, velocities and torques.

A driver publishes faster than it measures, and repeats what it has: each field keeps only the
samples that are new (`new_samples.py`). `driver_quirks.py` undoes other habits of drivers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.payload.driver_quirks import in_newton_metres, in_radians, match_joints
from analysis.payload.new_samples import new_samples
from analysis.selection import check_start, no_topic
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array
from tunenet_logs.clock_jumps import part_on_grid
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.left_out import LeftOut
from tunenet_logs.terminal import FEW_NAMES, listed

# Of the two fields that a payload is found from: what has one is of joints, whatever its name.
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
