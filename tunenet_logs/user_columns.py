"""Read the message fields that the user names with `--columns`: positions, joints and impacts.

`UserColumnRows` gathers the fields of one topic, message by message; `UserColumns` those of all.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import UNREADABLE, Signal, added
from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import (
    NUMBERS,
    NotThereError,
    RawChannel,
    Structure,
    UnusableError,
    likely_field,
    node_at,
    numbers_in,
    time_ns,
)
from tunenet_logs.formats.by_shape import (
    AnyType,
    SchemaBudget,
    Steps,
    any_type,
    stamp_steps,
    structure_of,
    unit_of,
)
from tunenet_logs.formats.columns.table import frame_stamps, position_signal
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.terminal import listed
from tunenet_logs.timing.stamps import order_samples, sorted_stamps

IMPACTS = "impacts"  # the signal of times of impacts
AXES = ("x", "y", "z")
# Quantities of joints, and their units.
_QUANTITIES = {"position": "rad", "velocity": "rad/s", "effort": "N·m", "current": "A"}

_STAMPS = ("t", "frame", "times")  # what is a time, or counts as one
_STEP = re.compile(r"\.?([^.\[\]]+)|\[(\d{1,6})\]")
_MAX_LISTED = 8  # topics or fields that an error names
_TICKS_NS = (1e9, 1e6, 1e3, 1.0)  # nanoseconds in what a number may count: s, ms, µs, ns
_MAX_NS = 2.0**62
_CLOSE = 3.0  # how much longer or shorter a span may be than on the log's own clock, to be the same


@dataclass
class _Column:
    """Values of one field so far."""

    get: Callable[[Any], Any]
    is_time: bool
    values: list[float] | array[float]


class UserColumnRows:
    """User's columns of one topic.

    Args:
        path: the log.
        channel: of the topic.
        picks: what each target is, behind the topic's name.
        kind: how its messages are read.

    Raises:
        LogError: a field is not there.
    """

    def __init__(
        self, path: Path, channel: RawChannel, picks: Mapping[str, str], kind: AnyType
    ) -> None:
        self.topic = channel.topic
        self.targets = tuple(picks)
        self.decode = kind.decode
        self._path = path
        self._type_name = channel.type_name
        self._picks = picks
        self._kind = kind
        self._columns: dict[str, _Column] | None = None
        self._stamp: Callable[[Any], Any] | None = None
        self._log_ns = array("q")
        self._header_ns = array("q")
        if kind.structure is not None:
            self._resolve(kind.structure)

    def _resolve(self, top: Structure) -> None:
        self._columns = {}
        for target, rest in self._picks.items():
            if rest or target != "times":
                get, is_time = self._field(top, target, rest)
                values: Any = array("d") if target not in _STAMPS else []
                self._columns[target] = _Column(get, is_time, values)
        if steps := stamp_steps(top):
            self._stamp = self._kind.getter(steps)

    def _field(self, top: Structure, target: str, rest: str) -> tuple[Callable[[Any], Any], bool]:
        steps: Steps = tuple(
            int(match[2]) if match[2] else match[1] for match in _STEP.finditer(rest)
        )
        why = ""
        try:
            node = node_at(top, steps)
            is_time = isinstance(node, Structure) and node.is_time
            if node in NUMBERS or (is_time and target in _STAMPS):
                return self._kind.getter(steps), is_time
            why = "is no number" if steps else "is a whole message"
        except NotThereError as error:
            why = f"has no {error}"
        numbers = numbers_in(top)
        likely = f"{target}={self.topic}.{likely_field(numbers)}" if numbers else ""
        raise LogError(
            f"{self._path}: --columns {target}={self.topic}{rest[:80]} {why}; of {self.topic} "
            f"there are: {listed(numbers, _MAX_LISTED) or 'none'}"
            + (f"; write --columns {likely}" if likely else "")
        )

    def add(self, log_ns: int, message: Any) -> None:
        """Append one message.

        Raises:
            LogError: a field is not there.
            ValueError, TypeError, AttributeError: it makes no sense.
        """
        if self._columns is None:
            self._resolve(structure_of(message))
        assert self._columns is not None
        row: list[Any] = []
        for column in self._columns.values():
            try:
                value = column.get(message)
            except LookupError:  # a list is shorter, a part is absent
                value = None
            if column.is_time and value is not None:
                value = time_ns(value)
            row.append(float("nan") if value is None else value)
        header_ns = time_ns(self._stamp(message)) if self._stamp is not None else 0
        row = [value if isinstance(value, int) else float(value) for value in row]
        self._header_ns.append(header_ns)
        self._log_ns.append(log_ns)
        for column, value in zip(self._columns.values(), row, strict=True):
            column.values.append(value)

    def signals(self, options: ReadOptions) -> tuple[list[Signal], list[str]]:
        """Return the signals of the fields, and notes on what was repaired."""
        if not len(self._log_ns) or self._columns is None:
            return [], []
        log_ns = np.frombuffer(self._log_ns, np.int64)
        header_ns = np.frombuffer(self._header_ns, np.int64)
        found: list[Signal] = []
        notes: list[str] = []
        if "times" in self.targets:
            impacts, repairs = self._impacts(header_ns, log_ns)
            found.append(impacts)
            notes += [f"{IMPACTS}: {repair}" for repair in repairs]
        keep, stamps_ns, counts, repairs, left_out = self._stamps(header_ns, log_ns, options)
        notes += [f"{self.topic}: {repair}" for repair in repairs]
        if any(axis in self._columns for axis in AXES):
            values = np.zeros((len(log_ns), 3))
            for at, axis in enumerate(AXES):
                if axis in self._columns:
                    values[:, at] = self._columns[axis].values
            unit = unit_of(self._type_name)
            if options.length_unit:  # goes before what a type says: someone looked
                unit = ""
            signal, more = position_signal(
                self.topic, stamps_ns, values[keep], unit, options, counts_frames=counts
            )
            found.append(replace(signal, left_out=added(signal.left_out, left_out)))
            notes += more
        for quantity, unit in _QUANTITIES.items():
            joints = self._joints(quantity)
            if joints:
                signal = self._joint_signal(quantity, unit, joints, keep, stamps_ns, options)
                found.append(replace(signal, left_out=left_out))
        return [signal for signal in found if len(signal.stamps_ns)], notes

    def _joints(self, quantity: str) -> list[int]:
        return sorted(
            int(target.rpartition("_")[2])
            for target in self.targets
            if target.startswith(f"{quantity}_")
        )

    def _joint_signal(
        self,
        quantity: str,
        unit: str,
        joints: Sequence[int],
        keep: NDArray[np.intp],
        stamps_ns: NDArray[np.int64],
        options: ReadOptions,
    ) -> Signal:
        assert self._columns is not None
        values = np.column_stack([self._columns[f"{quantity}_{one}"].values for one in joints])
        values = values[keep]
        values[~np.isfinite(values)] = np.nan
        if quantity == "current" and options.torque_constants:
            if len(options.torque_constants) != len(joints):
                raise LogError(
                    f"{self._path}: --torque-constants has {len(options.torque_constants)} "
                    f"numbers for {len(joints)} currents; give one for each"
                )
            quantity, unit = "effort", "N·m"
            values = values * np.array(options.torque_constants)
        names = tuple(f"joint{one}" for one in joints)
        return Signal(f"{self.topic}.{quantity}", stamps_ns, values, names, unit)

    def _stamps(
        self, header_ns: NDArray[np.int64], log_ns: NDArray[np.int64], options: ReadOptions
    ) -> tuple[NDArray[np.intp], NDArray[np.int64], bool, list[str], dict[str, int]]:
        """Return rows to keep, their stamps, whether these count frames, repairs, losses."""
        assert self._columns is not None
        given = self._columns.get("t") or self._columns.get("frame")
        if given is None:
            keep, stamps_ns, notes, left_out = order_samples(header_ns, log_ns, self._values())
            return keep, stamps_ns, False, notes, left_out
        counts = False
        if "t" in self._columns:
            own_ns, usable = _as_ns(given, log_ns)
        else:
            frames = np.array(given.values, np.float64)
            usable = np.flatnonzero(np.abs(frames) < 2**40)
            own_ns, counts = frame_stamps(frames[usable], None, options)
        keep, stamps_ns, notes, left_out = sorted_stamps(own_ns, self._values(usable))
        untimed = {UNREADABLE: len(log_ns) - len(usable)}
        return usable[keep], stamps_ns, counts, notes, added(left_out, untimed)

    def _values(self, rows: NDArray[np.intp] | None = None) -> list[NDArray[np.float64]]:
        """Return what the fields that are no times hold, each of shape (T,)."""
        assert self._columns is not None
        of_samples = (one.values for name, one in self._columns.items() if name not in _STAMPS)
        columns = [np.asarray(values, np.float64) for values in of_samples]
        return columns if rows is None else [values[rows] for values in columns]

    def _impacts(
        self, header_ns: NDArray[np.int64], log_ns: NDArray[np.int64]
    ) -> tuple[Signal, list[str]]:
        assert self._columns is not None
        if "times" in self._columns:
            own_ns, _ = _as_ns(self._columns["times"], log_ns)
            _, stamps_ns, notes, _ = sorted_stamps(own_ns)
        else:
            _, stamps_ns, notes, _ = order_samples(header_ns, log_ns)
        return Signal(IMPACTS, stamps_ns, np.ones((len(stamps_ns), 1)), ("impact",), "1"), notes


def _as_ns(
    column: _Column, log_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Return the stamps of a field [ns], and which messages have one.

    The log's own clock determines the unit of a number; else it is seconds.
    """
    usable = [at for at, value in enumerate(column.values) if abs(value) < _MAX_NS]
    values: Iterable[float] = [column.values[at] for at in usable]
    tick = 1.0 if column.is_time else _tick_ns(list(values), log_ns)
    stamps = [
        value * int(tick) if isinstance(value, int) else round(value * tick) for value in values
    ]
    inside = [at for at, stamp in enumerate(stamps) if abs(stamp) < _MAX_NS]
    own_ns = np.array([stamps[at] for at in inside], np.int64)
    return own_ns, np.array([usable[at] for at in inside], np.intp)


def _tick_ns(values: Sequence[float], log_ns: NDArray[np.int64]) -> float:
    span, heard_ns = (float(max(values) - min(values)) if values else 0.0), float(np.ptp(log_ns))
    if not span or not heard_ns:
        return _TICKS_NS[0]
    best = min(_TICKS_NS, key=lambda tick: abs(np.log(span * tick / heard_ns)))
    return best if 1 / _CLOSE < span * best / heard_ns < _CLOSE else _TICKS_NS[0]


# ---- All topics: find the fields that are named, and say which are not there


class UserColumns:
    """The user's columns (`--columns`), gathered while the log is read."""

    def __init__(self, path: Path, options: ReadOptions, budget: SchemaBudget) -> None:
        self._path = path
        self._options = options
        self._budget = budget
        self._topics: list[UserColumnRows] = []
        self._channels: list[RawChannel] = []
        self._found: set[str] = set()
        self._missed: dict[str, LogError] = {}  # why not, by topic

    def rows_of(self, channel: RawChannel) -> UserColumnRows | None:
        """Return the collector of a channel's named fields; None if one is absent."""
        self._channels.append(channel)
        picks = {
            target: rest
            for target, text in self._options.columns.items()
            if target not in self._found and (rest := _behind(text, channel.topic)) is not None
        }
        if not picks:
            return None
        try:
            rows = UserColumnRows(self._path, channel, picks, any_type(channel, self._budget))
        except UnusableError as reason:
            why = f"{self._path}: {channel.topic} cannot be read: {reason}"
            self._missed.setdefault(channel.topic, LogError(why, "name another topic"))
            return None
        except LogError as error:  # another channel of that topic may have it
            self._missed.setdefault(channel.topic, error)
            return None
        self._found.update(picks)
        self._topics.append(rows)
        return rows

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return the signals of the user's columns, and notes on what was repaired.

        Raises:
            LogError: a topic is missing, or the columns do not go together.
        """
        for target, text in self._options.columns.items():
            if target not in self._found:
                missed = [
                    error
                    for topic, error in self._missed.items()
                    if _behind(text, topic) is not None
                ]
                raise missed[0] if missed else self._no_topic(target, text)
        self._check()
        found: list[Signal] = []
        notes: list[str] = []
        for rows in self._topics:
            signals, repairs = rows.signals(self._options)
            found += signals
            notes += repairs
        if not found:
            raise LogError(
                f"{self._path}: the fields that --columns names hold no value", "name others"
            )
        return found, notes

    def _check(self) -> None:
        """Check that each group of columns comes from one topic."""
        groups: dict[str, set[str]] = {}
        for rows in self._topics:
            for target in rows.targets:
                group = "x, y and z" if target in AXES else target.partition("_")[0]
                if target not in ("t", "frame"):
                    groups.setdefault(group, set()).add(rows.topic)
        for group, topics in groups.items():
            if len(topics) > 1:
                shown = " and ".join(sorted(topics)[:2])
                raise LogError(f"{self._path}: {group} come from {shown}; name fields of one topic")
        if {"effort", "current"} <= set(groups) and self._options.torque_constants:
            raise LogError(f"{self._path}: --columns names efforts and currents; name one of them")

    def _no_topic(self, target: str, text: str) -> LogError:
        topics = list(dict.fromkeys(channel.topic for channel in self._channels))
        example = ""
        for channel in self._channels:
            try:
                structure = any_type(channel, self._budget).structure
            except UnusableError:
                continue
            if structure is not None and (fields := numbers_in(structure)):
                example = f"; write TOPIC.FIELD, such as --columns {target}={channel.topic}."
                example += likely_field(fields)
                break
        return LogError(
            f"{self._path}: no topic of --columns {target}={text[:80]} "
            f"(there are: {listed(topics, _MAX_LISTED) or 'none'})",
            f"name one of these{example}" if topics else "leave --columns out",
        )


def _behind(text: str, topic: str) -> str | None:
    """Return what follows a topic's name in a text; None where the text does not begin with it."""
    for name in (topic, topic.lstrip("/")):
        if name and text.startswith(name):
            rest = text[len(name) :]
            if not rest or rest[0] in ".[":
                return rest
    return None
