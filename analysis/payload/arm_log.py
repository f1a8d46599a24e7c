"""What a log says of an arm: fresh samples of its joints' positions, velocities and torques.

A driver publishes faster than it measures, and repeats what it has: each field keeps only the
samples that are new. Positions may be in degrees, and jump where an angle is cut to one turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from analysis.payload.joint_angles import in_radians
from analysis.payload.joint_names import match_joints
from analysis.payload.refresh_times import even_clock
from analysis.selection import check_start
from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.wording import listed

_Found = TypeVar("_Found")

_UNITS = ("N·m", "rad")
_FEWEST = 20
_RESTS = 6.0
"""Refresh periods after which an unchanged position means that the arm rests."""

_STALE = 0.03
"""Share of repeated samples from which on a driver publishes faster than it measures."""

_JUMP = 0.02
"""What an arm that begins to move covers by the next sample at most [rad]."""


@dataclass(frozen=True, eq=False)
class Samples:
    """One field of all joints, where it is new.

    Attributes:
        topic: where it came from.
        seconds: since the log's first sample [s], shape (T,), increasing.
        values: shape (T, J), in the arm's order of joints.
        repeated: share of what was recorded that only repeats the sample before.
        late_s: how much later than measured a sample may be stamped; 0 where its time is known.
    """

    topic: str
    seconds: Array
    values: Array
    repeated: float
    late_s: float

    def __post_init__(self) -> None:
        for one in (self.seconds, self.values):
            one.flags.writeable = False

    @property
    def rate_hz(self) -> float:
        """Median rate of fresh samples [Hz]."""
        return 1 / float(np.median(np.diff(self.seconds)))


@dataclass(frozen=True, eq=False)
class ArmLog:
    """An arm's recording.

    Attributes:
        joints: names in the log, in the arm's order.
        position: [rad], without jumps of whole turns.
        velocity: [rad/s] as the driver says; None where it does not.
        effort: [N·m] as the driver says, whatever its sign means.
        warnings: what was converted or is doubtful.
    """

    joints: tuple[str, ...]
    position: Samples
    velocity: Samples | None
    effort: Samples
    warnings: tuple[str, ...]

    @property
    def constant(self) -> NDArray[np.bool_]:
        """Whose torque never changes: no sensor does that; shape (J,)."""
        return np.ptp(self.effort.values, axis=0) == 0


def read_arm_log(
    episode: Episode,
    arm: Arm,
    *,
    topic: str | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
) -> ArmLog:
    """Find the joints of an arm in an episode.

    Args:
        episode: a log's.
        arm: whose joints are looked for.
        topic: which to prefer where several would do; it is to have joints of the arm.
        start_s: where to begin [s since the first sample]; None for there.
        end_s: where to end [s since the first sample]; None for the last.

    Raises:
        NotFoundError: no torques, joints or topic that are not there, or too little of them.
    """
    if topic is not None:
        topic = _checked_topic(episode, arm, topic)
    effort = _pick(episode, "N·m", arm, topic, "joint torques")
    prefer = topic if topic and _has(episode, topic, "rad") else _topic(effort)
    position = _pick(episode, "rad", arm, prefer, "joint positions")
    velocity = _where_enough(
        lambda: _pick(episode, "rad/s", arm, _topic(position), "joint velocities")
    )
    effort = _measured(effort, arm)
    used = [one for one in (effort, position, velocity) if one is not None]
    first_ns = min(int(one.stamps_ns[0]) for one in used)
    last_ns = max(int(one.stamps_ns[-1]) for one in used)
    check_start(start_s, (last_ns - first_ns) * 1e-9)
    begin = -np.inf if start_s is None else start_s
    end = np.inf if end_s is None else end_s

    def fresh(signal: Signal, *, rests: bool) -> Samples:
        return _fresh(signal, arm, first_ns, (begin, end), rests=rests)

    places = match_joints(arm.joint_names, effort.columns)
    found = ArmLog(
        joints=tuple(effort.columns[place] for place in places),
        position=fresh(position, rests=True),
        velocity=_where_enough(lambda: fresh(velocity, rests=True)) if velocity else None,
        effort=fresh(effort, rests=False),
        warnings=(),
    )
    angles, notes = in_radians(found.position.seconds, found.position.values, arm)
    return replace(found, position=replace(found.position, values=angles), warnings=tuple(notes))


def _where_enough(found: Callable[[], _Found]) -> _Found | None:
    """What is found; None where it is not, of what a log can do without."""
    try:
        return found()
    except NotFoundError:
        return None


def has_joints(episode: Episode, topic: str) -> bool:
    """Whether a topic tells torques or positions of joints, whatever their names."""
    return any(one.unit in _UNITS for one in episode.signals_of(topic))


def _checked_topic(episode: Episode, arm: Arm, topic: str) -> str:
    """The topic that a user named, without the name of one of its fields.

    Raises:
        NotFoundError: it has no joints, or none of them is the arm's.
    """
    reasons: list[str] = []
    for signal in episode.signals_of(topic):
        if signal.unit not in _UNITS:
            continue
        try:
            match_joints(arm.joint_names, signal.columns)
        except NotFoundError as error:
            reasons.append(f"{_topic(signal)}: {error}")
        else:
            return _topic(signal)
    if reasons:
        raise NotFoundError(reasons[0])
    usable = {_topic(one) for one in episode.signals.values() if one.unit in _UNITS}
    known = listed(sorted(usable)) or "none"
    raise NotFoundError(f"no usable topic {topic}; there is: {known}")


def _pick(episode: Episode, unit: str, arm: Arm, topic: str | None, what: str) -> Signal:
    """The signal of that unit which has all joints: the preferred topic's, else one that moves."""
    names = arm.joint_names
    there = [one for one in episode.signals.values() if one.unit == unit]
    if not there:
        raise NotFoundError(
            f"no {what} in this log (there: {listed(tuple(episode.signals))}): record the driver's "
            "JointState with position and effort, or its joint_torques topic beside it"
        )
    ordered = sorted(there, key=lambda one: (_topic(one) != topic, _is_still(one)))
    reasons: list[str] = []
    for signal in ordered:
        try:
            match_joints(names, signal.columns)
        except NotFoundError as error:
            reasons.append(f"{_topic(signal)}: {error}")
        else:
            return signal
    raise NotFoundError(reasons[0])


def _measured(effort: Signal, arm: Arm) -> Signal:
    """Torques as a sensor gives them; 0 for a joint whose torque is never a number.

    Raises:
        NotFoundError: no sensor gives these.
    """
    places = match_joints(arm.joint_names, effort.columns)
    told: NDArray[np.bool_] = np.any(np.isfinite(effort.values), axis=0)
    if not told[list(places)].any():
        raise NotFoundError(
            f"{_topic(effort)}: no torque is a number: record the topic on which the driver gives "
            "measured torques"
        )
    effort = replace(effort, values=np.where(told, effort.values, 0.0))
    values = effort.values[:, places]
    finite = values[np.isfinite(values).all(axis=1)]
    if len(finite) and not np.any(finite):
        raise NotFoundError(
            f"{_topic(effort)}: every torque is 0: record the topic on which the driver gives "
            "measured torques"
        )
    if len(finite) and not np.any(np.ptp(finite, axis=0)):
        raise NotFoundError(
            f"{_topic(effort)}: no torque ever changes: the driver was stuck, or measures none"
        )
    return effort


def _fresh(
    signal: Signal, arm: Arm, first_ns: int, part: tuple[float, float], *, rests: bool
) -> Samples:
    """What is new in it; with `rests`, also what stays the same for long."""
    places = match_joints(arm.joint_names, signal.columns)
    seconds = (signal.stamps_ns - first_ns).astype(np.float64) * 1e-9
    values = signal.values[:, places]
    keep = np.isfinite(values).all(axis=1) & (seconds >= part[0]) & (seconds <= part[1])
    seconds, values = seconds[keep], values[keep]
    new = np.ones(len(seconds), dtype=bool)
    new[1:] = np.any(values[1:] != values[:-1], axis=1)
    share = 1 - float(np.mean(new)) if len(new) else 0.0
    if rests and new.any():
        new |= _resting(seconds, values, new)
    if np.count_nonzero(new) < _FEWEST:
        raise NotFoundError(
            f"{signal.name}: {np.count_nonzero(new)} samples of all joints are new (wanted: "
            f"{_FEWEST} or more): record for 5 s, at the driver's highest rate"
        )
    before = np.concatenate([seconds[:1], seconds[:-1]])[new]
    late_s = float(np.median(np.diff(seconds))) if share > _STALE else 0.0
    times = even_clock(before, seconds[new]) if share > _STALE else None
    if times is None:
        return Samples(_topic(signal), seconds[new], values[new], share, late_s)
    return Samples(_topic(signal), times, values[new], share, 0.0)


def _resting(seconds: Array, values: Array, new: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples at which nothing has changed for so long that the arm rests.

    Where it then is suddenly elsewhere it did not rest: the driver was stuck.
    """
    places = np.flatnonzero(new)
    told = seconds[places] if len(places) >= _FEWEST else seconds
    period = float(np.median(np.diff(told))) if len(told) > 1 else 0.0
    rests = np.zeros(len(new), dtype=bool)
    for begin, end in zip(places, [*places[1:], len(new)], strict=True):
        if end < len(new) and np.abs(values[end] - values[begin]).max() > _JUMP:
            continue
        rests[begin:end] = seconds[begin:end] - seconds[begin] > _RESTS * period
    return rests


def _is_still(signal: Signal) -> bool:
    told = signal.values[:, np.isfinite(signal.values).any(axis=0)]
    finite = told[np.isfinite(told).all(axis=1)]
    return not len(finite) or bool(np.all(np.ptp(finite, axis=0) == 0))


def _has(episode: Episode, topic: str, unit: str) -> bool:
    return any(one.unit == unit and _topic(one) == topic for one in episode.signals.values())


def _topic(signal: Signal) -> str:
    for ending in (".position", ".velocity", ".effort"):
        if signal.name.endswith(ending):
            return signal.name.removesuffix(ending)
    return signal.name
