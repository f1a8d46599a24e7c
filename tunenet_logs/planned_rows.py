"""Build the signals that were finally planned from trajectories sent to joints."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Signal
from tunenet_logs.formats.base import BeyondLimitError, UnusableError
from tunenet_logs.formats.message_types import PlanSample

_MAX_NAMES = 1000  # joints of one topic; more are no robot's, but a damaged or hostile log's
_MAX_BYTES = 4 * 1024 * 1024  # of a message: its points become objects, each larger than itself
_MAX_POINTS = 100_000  # of a message: a minute and a half of a controller at 1 kHz
# That all trajectories of a log may have, whatever its size is, and its bytes for each beyond.
_FREE_POINTS, _BYTES_A_POINT = 200_000, 50

# Points of one topic, and messages without any, times its joints: a table of them must fit.
_MAX_CELLS = 10_000_000

_LAST_NS = 2**63 - 1  # the last stamp that fits int64: in the year 2262
# Name and unit of each signal, in the order of a `PlanPoint`.
_QUANTITIES = (("position", "rad"), ("velocity", "rad/s"), ("effort", "N·m"))


class PointBudget:
    """Budget of trajectory points still to be read of a log of `log_bytes`."""

    def __init__(self, log_bytes: int) -> None:
        self._most = _FREE_POINTS + log_bytes // _BYTES_A_POINT
        self._left = self._most

    def check(self) -> None:
        """Check that the budget is not exhausted.

        Raises:
            BeyondLimitError: it is.
        """
        if self._left <= 0:
            raise BeyondLimitError(f"the log's trajectories have over {self._most} points")

    def spend(self, points: int) -> None:
        """Deduct points that were read.

        Raises:
            BeyondLimitError: there are not as many left.
        """
        self._left -= points
        if self._left < 0:
            self.check()


@dataclass
class _Plans:
    """Messages for the same joints, flattened."""

    numbers: array[int] = field(default_factory=lambda: array("q"))
    counts: array[int] = field(default_factory=lambda: array("q"))
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    values: tuple[array[float], ...] = field(
        default_factory=lambda: (array("d"), array("d"), array("d"))
    )


@dataclass(eq=False)
class PlannedRows:
    """Joint trajectory planned on one topic: positions [rad], velocities [rad/s], efforts [N·m].

    A later message replaces what an earlier one planned for its joints and the time after its own
    start; one without points replaces it by nothing, for all joints.

    Attributes:
        topic: its name.
        budget: of points, shared by all topics of the log.
    """

    topic: str
    budget: PointBudget
    _log_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _start_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _stops: array[int] = field(default_factory=lambda: array("q"), init=False)
    _plans: dict[tuple[str, ...], _Plans] = field(default_factory=dict, init=False)
    _joints: dict[str, None] = field(default_factory=dict, init=False)
    _points: int = field(default=0, init=False)

    def check(self, data: bytes | memoryview) -> None:
        """Refuse a message that is too large to be decoded, or beyond the budget.

        Raises:
            BeyondLimitError: it is larger than any trajectory, or enough of them were read.
        """
        if len(data) > _MAX_BYTES:
            raise BeyondLimitError(
                f"a message of {len(data)} bytes is over the limit of {_MAX_BYTES}"
            )
        self.budget.check()

    def add(self, log_ns: int, plan: PlanSample) -> None:
        """Append one message.

        Raises:
            UnusableError: its points do not follow each other in time; no controller takes it.
            BeyondLimitError: it has more joints or points than are read.
            ValueError, OverflowError: it makes no sense.
        """
        points = plan.points
        self.budget.spend(len(points))
        if len(points) > _MAX_POINTS:
            raise BeyondLimitError(f"over {_MAX_POINTS} points")
        start_ns = plan.stamp_ns or log_ns
        after_ns = [point[0] for point in points]
        if any(one < 0 for one in after_ns[:1]) or any(b <= a for a, b in pairwise(after_ns)):
            raise UnusableError("the times of its points do not increase from 0")
        if not -_LAST_NS <= start_ns <= _LAST_NS - max(after_ns, default=0):
            raise OverflowError("a time of it lies beyond the year 2262")
        columns = [_filled(points, place, len(plan.names)) for place in (1, 2, 3)] if points else []
        if points:
            plans = self._plans_of(plan.names, len(points))
            plans.numbers.append(len(self._log_ns))
            plans.counts.append(len(points))
            plans.stamps_ns.extend(start_ns + one for one in after_ns)
            for stored, values in zip(plans.values, columns, strict=True):
                stored.frombytes(values.tobytes())
        else:
            self._check_cells(1, len(self._joints))
            self._stops.append(len(self._log_ns))
        self._points += max(1, len(points))
        self._log_ns.append(log_ns)
        self._start_ns.append(start_ns)

    def _plans_of(self, names: tuple[str, ...], points: int) -> _Plans:
        """Return the messages for these joints.

        Raises:
            ValueError: two joints have one name, or there is none.
            BeyondLimitError: more joints or points than a topic may have.
        """
        known = self._plans.get(names)
        if known is None:
            if not names or len(set(names)) < len(names):
                raise ValueError("two joints have one name" if names else "it names no joint")
            if sum(map(len, self._plans)) + len(names) > _MAX_NAMES:
                raise BeyondLimitError(f"over {_MAX_NAMES} joints")
        joints = self._joints | dict.fromkeys(names)
        self._check_cells(points, len(joints))
        self._joints = joints
        return known or self._plans.setdefault(names, _Plans())

    def _check_cells(self, points: int, joints: int) -> None:
        """Raise BeyondLimitError where so many more points of so many joints do not fit."""
        if (self._points + points) * joints > _MAX_CELLS:
            raise BeyondLimitError(f"over {_MAX_CELLS} values planned")

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return the quantities that have any value as signals; nothing is ever repaired."""
        columns = tuple(self._joints)
        parts = [(column, *self._kept_of(column)) for column in columns]
        if not parts:
            return [], []
        stamps_ns = np.unique(np.concatenate([own_ns for _, own_ns, _ in parts]))
        places = {name: place for place, name in enumerate(columns)}
        found: list[Signal] = []
        for quantity, (label, unit) in enumerate(_QUANTITIES):
            values = np.full((len(stamps_ns), len(columns)), np.nan)
            for column, own_ns, three in parts:
                values[np.searchsorted(stamps_ns, own_ns), places[column]] = three[quantity]
            is_finite = np.isfinite(values)
            if is_finite.any():
                values[~is_finite] = np.nan
                name = f"{self.topic}.{label}"
                found.append(Signal(name, stamps_ns, values, columns, unit, drives=True))
        return found, []

    def _kept_of(self, joint: str) -> tuple[NDArray[np.int64], tuple[NDArray[np.float64], ...]]:
        """Return what was planned for a joint and not replaced: stamps [ns], and three quantities.

        What comes later goes before what came earlier, where both plan for one stamp.
        """
        groups = [(names, plans) for names, plans in self._plans.items() if joint in names]
        ends_ns = self._ends_ns([np.frombuffer(plans.numbers, np.int64) for _, plans in groups])
        arrived = np.frombuffer(self._log_ns, np.int64)
        stamps: list[NDArray[np.int64]] = []
        ranks: list[NDArray[np.int64]] = []
        values: list[list[NDArray[np.float64]]] = []
        for names, plans in groups:
            counts = np.frombuffer(plans.counts, np.int64)
            numbers = np.repeat(np.frombuffer(plans.numbers, np.int64), counts)
            own_ns = np.frombuffer(plans.stamps_ns, np.int64)
            keep = own_ns <= ends_ns[numbers]
            stamps.append(own_ns[keep])
            ranks.append(numbers[keep])
            place = names.index(joint)
            table = (np.frombuffer(one, np.float64).reshape(-1, len(names)) for one in plans.values)
            values.append([one[keep, place] for one in table])
        rank = np.concatenate(ranks)
        order = np.lexsort((rank, arrived[rank]))
        three = tuple(np.concatenate(one)[order] for one in zip(*values, strict=True))
        return np.concatenate(stamps)[order], three

    def _ends_ns(self, numbers: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
        """Return when each message's plan ends, shape (M,) [ns]: at the first start of a later one.

        Args:
            numbers: of the messages for one joint, in groups; the result is meant for those alone.
        """
        arrived, starts = (np.frombuffer(one, np.int64) for one in (self._log_ns, self._start_ns))
        stops = np.frombuffer(self._stops, np.int64)
        all_numbers = np.concatenate([*numbers, stops])
        order = all_numbers[np.lexsort((all_numbers, arrived[all_numbers]))]
        earliest = np.minimum.accumulate(starts[order][::-1])[::-1]
        ends_ns = np.full(len(starts), _LAST_NS)
        ends_ns[order[:-1]] = earliest[1:]
        return ends_ns


def _filled(points: Sequence[Sequence], place: int, width: int) -> NDArray[np.float64]:
    """Stack one quantity of all points, shape (points, joints); NaN where a point has none.

    Raises:
        ValueError: a point gives it of another number of joints.
    """
    values = np.full((len(points), width), np.nan)
    for row, point in zip(values, points, strict=True):
        given = point[place]
        if len(given):
            if len(given) != width:
                raise ValueError(f"it has {width} names but another number of values")
            row[:] = given
    return values
