"""Read the message fields that the user names with `--columns`: positions, joints and impacts.

`UserColumnRows` gathers the fields of one topic, message by message; `UserColumns` those of all.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Signal
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
from tunenet_logs.formats.columns.cells import MAX_NS, Clock
from tunenet_logs.formats.columns.names import JOINT_UNITS
from tunenet_logs.formats.columns.table import (
    ColumnPlan,
    ColumnRows,
    Group,
    Times,
    Used,
    fitted,
    signals_of,
)
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.terminal import listed
from tunenet_logs.timing.stamps import order_samples, sorted_stamps

IMPACTS = "impacts"  # the signal of times of impacts
AXES = ("x", "y", "z")
_STAMPS = ("t", "frame", "times")  # what is a time, or counts as one
_STEP = re.compile(r"\.?([^.\[\]]+)|\[(\d{1,6})\]")
_MAX_LISTED = 8  # topics or fields that an error names
_TICKS_NS = (1e9, 1e6, 1e3, 1.0)  # nanoseconds in what a number may count: s, ms, µs, ns
_CLOSE = 3.0  # how much longer or shorter a span may be than on the log's own clock, to be the same


@dataclass
class _Column:
    """Values of one field so far."""

    get: Callable[[Any], Any]
    is_time: bool
    values: list[float] | array[float]


class UserColumnRows:
    """User's columns of one topic; `picks` says what each target is, behind the topic's name."""

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
        """Append one message; LogError where a field is not there."""
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
        columns = self._columns
        if not len(self._log_ns) or columns is None:
            return [], []
        log_ns = np.frombuffer(self._log_ns, np.int64)
        header_ns = np.frombuffer(self._header_ns, np.int64)
        always = np.ones(len(log_ns), np.bool_)
        found: list[Signal] = []
        notes: list[str] = []
        if "times" in self.targets:
            if "times" in columns:
                own = _as_ns(columns["times"], log_ns)
                _, stamps_ns, notes, _ = sorted_stamps(own.stamps_ns[own.known])
            else:
                _, stamps_ns, notes, _ = order_samples(header_ns, log_ns)
            ones = np.ones((len(stamps_ns), 1))
            found.append(Signal(IMPACTS, stamps_ns, ones, ("impact",), "1"))
            notes = [f"{IMPACTS}: {note}" for note in notes]
        stamp: Clock | None = None
        if "t" in columns:
            clock, times = Clock("t", (), 0), _as_ns(columns["t"], log_ns)
        elif "frame" in columns:
            frames = np.array(columns["frame"].values, np.float64)
            known = np.abs(frames) < 2**32
            clock = Clock("frame", (), 0, counts_frames=True)
            ns = np.round(np.where(known, frames, 0) * 1e9).astype(np.int64)
            times = Times(ns, known)
        else:
            clock, stamp, times = Clock("log", (), 0), Clock("header", (), 0), Times(log_ns, always)
        names = [name for name in columns if name not in _STAMPS]
        unit = "" if options.length_unit else unit_of(self._type_name)  # someone looked
        groups: list[Group] = []
        if axes := [Used(names.index(one), at, 1.0) for at, one in enumerate(AXES) if one in names]:
            groups.append(Group(self.topic, AXES, unit, tuple(axes), clock, stamp, is_track=True))
        for quantity, unit in JOINT_UNITS.items():
            numbers = sorted(int(n[len(quantity) + 1 :]) for n in names if n.startswith(quantity))
            used = tuple(
                Used(names.index(f"{quantity}_{number}"), at, 1.0)
                for at, number in enumerate(numbers)
            )
            labels = tuple(f"joint{number}" for number in numbers)
            name = f"{self.topic}.{quantity}"
            groups += [Group(name, labels, unit, used, clock, stamp)] if used else []
        if groups:
            plan = fitted(
                self._path, ColumnPlan(tuple(names), tuple(groups), is_stacked=True), options
            )
            values = {at: np.asarray(columns[one].values, float) for at, one in enumerate(names)}
            clocks = {clock: times, Clock("header", (), 0): Times(header_ns, always)}
            rows = ColumnRows(values, clocks, np.zeros(len(log_ns), np.int64), [""])
            made = signals_of(self._path, plan, rows, options)
            found += made.signals
            notes += made.notes
        return [signal for signal in found if len(signal.stamps_ns)], notes


def _as_ns(column: _Column, log_ns: NDArray[np.int64]) -> Times:
    """Return the stamps of a field [ns]: numbers in the unit that fits the log, else in seconds."""
    usable = [value for value in column.values if abs(value) < MAX_NS]
    tick = 1.0 if column.is_time else _TICKS_NS[0]
    span, heard_ns = (float(max(usable) - min(usable)) if usable else 0.0), float(np.ptp(log_ns))
    if not column.is_time and span and heard_ns:
        best = min(_TICKS_NS, key=lambda unit: abs(np.log(span * unit / heard_ns)))
        tick = best if 1 / _CLOSE < span * best / heard_ns < _CLOSE else tick
    stamps = [
        value * int(tick) if isinstance(value, int) else round(value * tick) for value in usable
    ]
    known = np.array([abs(value) < MAX_NS for value in column.values], np.bool_)
    ns = np.zeros(len(known), np.int64)
    inside = np.array([abs(stamp) < MAX_NS for stamp in stamps], np.bool_)
    known[known] = inside
    ns[known] = [stamp for stamp in stamps if abs(stamp) < MAX_NS]
    return Times(ns, known)


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
        """Return the signals of the user's columns, and notes on what was repaired."""
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
