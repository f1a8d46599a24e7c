"""Find fields in messages: positions by names and shapes, or those that a user names.

`things_of` finds what in an unknown type is a measured position, or says why that is ambiguous:
then the user chooses with `--columns`, which `UserColumns` reads: positions, joints and impacts.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import COMMANDS, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import (
    MAX_NODES,
    NUMBERS,
    AnyType,
    Listed,
    MessageError,
    Node,
    Plain,
    RawChannel,
    Steps,
    Structure,
    UnusableError,
    time_ns,
    type_key,
)
from tunenet_logs.formats.columns.cells import MAX_NS, Clock
from tunenet_logs.formats.columns.names import JOINT_UNITS
from tunenet_logs.formats.columns.plan import (
    ColumnPlan,
    Group,
    Used,
    fitted,
)
from tunenet_logs.formats.columns.signals import (
    ColumnRows,
    Times,
    signals_of,
)
from tunenet_logs.formats.decoders import MAX_TYPE_DEPTH, Decoders
from tunenet_logs.formats.message_types import PositionSample
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.ros import SCHEMA_ENCODINGS
from tunenet_logs.terminal import listed
from tunenet_logs.timing.stamps import order_samples, sorted_stamps


class NotThereError(LookupError):
    """A field that a type lacks, named by the message."""


def node_at(top: Structure, steps: Steps) -> Node:
    """Return the part of a type at a path; raise NotThereError where it has none."""
    node: Node = top
    for step in steps:
        if isinstance(step, int):
            if not isinstance(node, Listed) or (node.count is not None and step >= node.count):
                raise NotThereError(f"[{step}]")
            node = node.of
        else:
            if not isinstance(node, Structure) or step not in node.fields:
                raise NotThereError(step)
            node = node.fields[step]
    return node


def numbers_in(node: Node, path: str = "") -> list[str]:
    """List the numeric and time fields of a type, as `--columns` names them; 200 at most."""
    if isinstance(node, Listed):
        return numbers_in(node.of, f"{path}[0]")
    if isinstance(node, Structure) and not node.is_time:
        inside = ((f"{path}.{name}" if path else name, one) for name, one in node.fields.items())
        return [field for name, one in inside for field in numbers_in(one, name)][:200]
    return [path] if isinstance(node, Structure) or node in NUMBERS else []


def likely_field(fields: Sequence[str]) -> str:
    """Return the field most likely meant: the first z, else the last."""
    return next((field for field in fields if field.split(".")[-1] == "z"), fields[-1])


def structure_of(message: Any) -> Structure:
    """Infer the structure of a decoded JSON message from its values."""
    seen = 0

    def node_of(value: Any, depth: int) -> Node:
        nonlocal seen
        seen += 1
        if depth > MAX_TYPE_DEPTH or seen > MAX_NODES:
            return Plain.OTHER
        if isinstance(value, SimpleNamespace):
            return Structure(
                "", {name: node_of(one, depth + 1) for name, one in vars(value).items()}
            )
        if isinstance(value, list):
            of = node_of(value[0], depth + 1) if value else Plain.OTHER
            return Listed(of, None if isinstance(of, Structure) else len(value))
        plain = {bool: Plain.FLAG, int: Plain.WHOLE, float: Plain.NUMBER, str: Plain.TEXT}
        return plain.get(type(value), Plain.OTHER)

    node = node_of(message, 0)
    return node if isinstance(node, Structure) else Structure("", {})


# ---- Find the positions in a type, by names and shapes.

# Fields that lead to where something is; what lists of bare points are called, without an s.
_WORD = re.compile(
    "pose|position|point|translation|transform|pose_stamped|location|odometry|odom|pos|center|"
    "centroid|bbox|coordinates"
)
_LIST = re.compile(
    f"{_WORD.pattern}|marker|object|ball|track|detection|body|bodies|entity|target|obstacle"
)
# Packages whose types are said to be in metres.
_IN_METRES = re.compile(
    "(geometry_msgs|nav_msgs|tf2_msgs|visualization_msgs|vision_msgs|gazebo_msgs|foxglove)\\b"
)
# Types whose positions are planned, maps, clouds, or directions.
_NOT_MEASURED = re.compile(
    "(sensor|trajectory|moveit|shape|map|tunenet)_msgs/|rcl_interfaces/|nav_msgs/msg/(Path|Map)|"
    "geometry_msgs/msg/(Vector3|Quaternion|Polygon)|visualization_msgs/msg/InteractiveMarker|"
    r"foxglove\.(PointCloud|LaserScan|Grid|Scene|VoxelGrid|Log|CameraCalibration)"
)
# Flags of an object, with their value where it is not seen.
_UNSEEN = {"occluded": True, "is_occluded": True}
_UNSEEN |= dict.fromkeys(("tracking_valid", "is_tracking_valid", "tracked", "is_tracked"), False)
_UNSEEN |= dict.fromkeys(("valid", "is_valid", "visible", "is_visible"), False)
# Fields that identify an object.
_NAME = re.compile("name|ns|child_frame_id|label|subject|id|.*_name", re.DOTALL)
_NUMBER = re.compile("id|.*_id", re.DOTALL)
_MAX_PLACE_DEPTH = 6  # of fields within fields, down to a position
Get = Callable[[Any], Any]


@dataclass(frozen=True)
class _Thing:
    """Getters of one object's position, identity and visibility in part of a message."""

    place: Get
    is_list: bool
    names: tuple[Get, ...]
    numbers: tuple[Get, ...]
    indices: tuple[Get, ...]
    unseen: tuple[tuple[Get, bool], ...]
    stamp: Get | None
    action: Get | None


# Of parts of a message: a label, getters of its entries (None: the message is one) and their names.
_Things = Sequence[tuple[str, Get | None, Get | None, _Thing]]


def may_hold_positions(type_name: str) -> bool:
    """Return whether positions of a type may be measured, not planned, mapped or directions."""
    return not _NOT_MEASURED.match(type_key(type_name))


def unit_of(type_name: str) -> str:
    """Return the unit of a type's positions: "m", or "" where it is unstated."""
    return "m" if _IN_METRES.match(type_key(type_name)) else ""


def _samples(thing: _Thing, entry: Any, name: str, stamp_ns: int) -> list[PositionSample]:
    if any(bool(get(entry)) is value for get, value in thing.unseen):
        return []
    if thing.action is not None and thing.action(entry) in (2, 3):  # a marker is taken away
        return []
    try:
        place = thing.place(entry)
    except LookupError:  # protobuf says so
        return []
    x, y, z = place if thing.is_list else (place.x, place.y, place.z)
    if x is None or y is None or z is None:
        return []
    own_ns = time_ns(thing.stamp(entry)) if thing.stamp is not None else 0
    return [(own_ns or stamp_ns, name, "", float(x), float(y), float(z))]


def _identity(thing: _Thing, entry: Any) -> str:
    parts = [str(get(entry)) for get in thing.names]
    named = any(parts)
    for get in thing.numbers:
        value = get(entry)
        if isinstance(value, int):
            parts.append(str(value))
        elif len(value):  # a bundle of tags has several
            parts.append("-".join(str(int(one)) for one in value[:8]))
    if not named and not thing.numbers:
        parts = [str(get(entry)) for get in thing.indices]
    return ".".join(part for part in parts if part)[:200]


def things_of(kind: AnyType, top: Structure) -> _Things | str:
    """Find the positions in a type; else return why there are none ("": no evidence)."""
    if places := _places(top, _MAX_PLACE_DEPTH):
        if len(places) > 1:
            shown = ", ".join(".".join(map(str, place)) for place in places[:3])
            return f"it names several positions ({shown})"
        thing = _thing(kind, top, places[0])
        # The number of a message by itself may count messages; a marker's is a part of its name.
        thing = thing if thing.action else replace(thing, numbers=(), indices=())
        return [("", None, None, thing)]
    lists: list[tuple[str, Get | None, Get | None, _Thing]] = []
    for name, node in top.fields.items():
        if not isinstance(node, Listed) or not isinstance(node.of, Structure):
            continue
        if node.of.is_place and not _LIST.fullmatch(name.lower().removesuffix("s")):
            continue
        places = _places(node.of, _MAX_PLACE_DEPTH - 1)
        if len(places) == 1:
            names = _beside(kind, top, name)
            lists.append((name, kind.getter((name,)), names, _thing(kind, node.of, places[0])))
    if len(lists) == 1:
        return [("", *lists[0][1:])]
    return [(f"{name}.", *rest) for name, *rest in lists] or ""  # type: ignore[misc]


def _places(node: Node, depth: int) -> list[Steps]:
    """Return the paths to positions within a node."""
    if isinstance(node, Listed):
        return [()] if node.count == 3 and node.of in NUMBERS else []
    if not isinstance(node, Structure) or not depth:
        return []
    if node.is_place:
        return [()]
    return [
        (name, *rest)
        for name, inner in node.fields.items()
        if _WORD.fullmatch(name.lower())
        for rest in _places(inner, depth - 1)
    ]


def _thing(kind: AnyType, node: Structure, place: Steps) -> _Thing:
    fields = node.fields

    def getters(of: Callable[[str, Node], bool]) -> tuple[Get, ...]:
        return tuple(kind.getter((name,)) for name, inner in fields.items() if of(name, inner))

    stamp = stamp_steps(node)
    is_marker = "action" in fields and "ns" in fields
    return _Thing(
        place=kind.getter(place) if place else lambda entry: entry,
        is_list=isinstance(node_at(node, place), Listed),
        names=getters(lambda name, inner: inner is Plain.TEXT and bool(_NAME.fullmatch(name))),
        numbers=getters(
            lambda name, inner: (
                (inner.of if isinstance(inner, Listed) else inner) is Plain.WHOLE
                and bool(_NUMBER.fullmatch(name))
            )
        ),
        indices=getters(lambda name, inner: name.endswith("index") and inner is Plain.WHOLE),
        unseen=tuple(
            (kind.getter((name,)), _UNSEEN[name])
            for name, inner in fields.items()
            if name in _UNSEEN and inner is Plain.FLAG
        ),
        stamp=kind.getter(stamp) if stamp else None,
        action=kind.getter(("action",)) if is_marker else None,
    )


def _beside(kind: AnyType, top: Structure, entries: str) -> Get | None:
    """Return the getter of the entries' names, where these stand in a list beside the entries."""
    for name in ("name", "names", f"{entries}_names"):
        node = top.fields.get(name)
        if isinstance(node, Listed) and node.of is Plain.TEXT:
            return kind.getter((name,))
    return None


def stamp_steps(node: Structure) -> Steps:
    """Return the path to a message's own stamp; empty where it has none."""
    for steps in (("header", "stamp"), ("stamp",), ("timestamp",), ("time",)):
        at: Node | None = node
        for step in steps:
            at = at.fields.get(step) if isinstance(at, Structure) else None
        if isinstance(at, Structure) and at.is_time:
            return steps
    return ()


# ---- `ShapeMessages`: read one channel by the shape of its messages.

# Without any of these in its definition, a type holds no position.
_HINT = re.compile(rb"\bz\b|position|translation|location|\[3\]|\bpos\b")
UNUSED = "its type is not one that a task uses"  # why most channels are not read


class ShapeMessages:
    """Reader of the positions in one channel's messages; without `things`, a message tells."""

    def __init__(self, kind: AnyType, things: _Things | None, decoders: Decoders) -> None:
        self._decoders, self._kind, self._things = decoders, kind, things
        self._tries = 100  # messages that may leave their shape open, as an empty list does
        self._top = kind.structure
        self._stamp = self._stamp_getter()
        self._counts: dict[str, int] = {}
        self._seen: set[str] = set()
        self._doubled = 0  # entries left out because another of the same message has their name
        self._refused = ""  # why the channel is not used

    def _stamp_getter(self) -> Get | None:
        steps = stamp_steps(self._top) if self._top else ()
        return self._kind.getter(steps) if steps else None

    def decode(self, data: bytes | memoryview) -> Any:
        """Decode a message, or raise MessageError; None where its shape is still unknown."""
        if self._things is not None:
            return None if self._refused else self._kind.decode(data)
        if not self._tries or self._decoders.left_guesses < len(data):
            return None
        self._tries -= 1
        self._decoders.left_guesses -= len(data)
        with suppress(MessageError):
            return self._kind.decode(data)
        return None

    def read(self, message: Any) -> Iterable[PositionSample]:
        """Return the positions of a message; its content may raise DAMAGED."""
        if message is None:
            return ()
        if self._things is None:
            self._top = structure_of(message)
            things = things_of(self._kind, self._top)
            if isinstance(things, str):
                self._refused = self._refused or things
                return ()
            self._things, self._refused, self._stamp = things, "", self._stamp_getter()
        if self._refused:
            return ()
        try:
            stamp_ns = time_ns(self._stamp(message)) if self._stamp is not None else 0
        except LookupError:
            stamp_ns = 0
        found: list[PositionSample] = []
        for label, entries_of, names_of, thing in self._things:
            if entries_of is None:
                name = _identity(thing, message) if thing.names else ""
                found += _samples(thing, message, name, stamp_ns)
                continue
            entries = entries_of(message)
            names = [_identity(thing, entry) for entry in entries]
            if names_of is not None:
                names = [str(name) for name in names_of(message)][: len(names)]
            names = self._told_apart(names, label)
            for name, entry in zip(names, entries, strict=False):
                if name:
                    found += _samples(thing, entry, label + name, stamp_ns)
        self._seen.update(sample[1] for sample in found)
        if len(self._seen) > 100:  # of one topic: more are no bodies, but a drawing
            self._refused = "it holds over 100 things"
        return () if self._refused else found

    def _told_apart(self, names: list[str], label: str) -> list[str]:
        """Return unique names: indices where unnamed, "" for duplicates, which are left out."""
        if not any(names):
            if names and self._counts.setdefault(label, len(names)) != len(names):
                self._refused = "its entries have no names, and their number changes"
            return [str(number) for number in range(len(names))]
        counts = Counter(names)
        once = [name if counts[name] == 1 else "" for name in names]
        self._doubled += once.count("")
        return once

    def outcome(self, topic: str) -> tuple[str, list[str]]:
        """Return why the channel is not used ("" where it is), and notes on it."""
        if self._refused:
            return f"{self._refused}; {_choose(topic, self._top)}", []
        if self._things is None:
            return UNUSED, []
        if self._doubled:
            why = f"{self._doubled} entries were left out that share their name with another"
            return "", [f"{topic}: {why}"]
        return "", []


def shape_messages(channel: RawChannel, decoders: Decoders) -> ShapeMessages | None:
    """Return a reader by shape, None without evidence; UnusableError where it is ambiguous."""
    is_json = channel.encoding == "json"
    hinted = is_json or not channel.schema or _HINT.search(channel.schema)
    if not hinted or not may_hold_positions(channel.type_name):
        return None
    try:
        kind = decoders.any_type(channel)
    except UnusableError:
        known = SCHEMA_ENCODINGS.get(channel.encoding)
        if known and channel.schema_encoding and channel.schema_encoding not in known:
            raise  # it may well be a type that a task uses
        return None
    if kind.structure is None:
        return ShapeMessages(kind, None, decoders)
    things = things_of(kind, kind.structure)
    if isinstance(things, str):
        if things:
            raise UnusableError(f"{things}; {_choose(channel.topic, kind.structure)}")
        return None
    return ShapeMessages(kind, things, decoders)


def _choose(topic: str, top: Structure | None) -> str:
    """Return the option to type where the shape alone is ambiguous."""
    fields = numbers_in(top) if top else []
    field = likely_field(fields) if fields else "FIELD"
    return f"choose one with --columns z={topic}.{field}"


# ---- `UserColumnRows`: gather the fields of one topic that a user names.

IMPACTS = "impacts"  # the signal of times of impacts
AXES = ("x", "y", "z")
_STAMPS = ("t", "frame", "times")  # what is a time, or counts as one
_STEP = re.compile(r"\.?([^.\[\]]+)|\[(\d{1,6})\]")
_MAX_LISTED = 8  # topics or fields that an error names


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
        self.topic, self.targets = channel.topic, tuple(picks)
        self.decode = kind.decode
        self._path, self._type_name = path, channel.type_name
        self._picks, self._kind = picks, kind
        self._columns: dict[str, _Column] | None = None
        self._stamp: Get | None = None
        self._log_ns, self._header_ns = array("q"), array("q")
        if kind.structure is not None:
            self._resolve(kind.structure)

    def _resolve(self, top: Structure) -> None:
        """Find the fields that are named in a type."""
        self._columns = {}
        for target, rest in self._picks.items():
            if rest or target != "times":
                get, is_time = self._field(top, target, rest)
                values: Any = array("d") if target not in _STAMPS else []
                self._columns[target] = _Column(get, is_time, values)
        if steps := stamp_steps(top):
            self._stamp = self._kind.getter(steps)

    def _field(self, top: Structure, target: str, rest: str) -> tuple[Get, bool]:
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
            value = None
            with suppress(LookupError):  # a list is shorter, a part is absent
                value = column.get(message)
            if value is None:
                row.append(float("nan"))
            else:
                row.append(time_ns(value) if column.is_time else value)
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
        for quantity, unit in (*JOINT_UNITS.items(), ("command", "1")):
            numbers = sorted(int(n[len(quantity) + 1 :]) for n in names if n.startswith(quantity))
            used = tuple(
                Used(names.index(f"{quantity}_{number}"), at, 1.0)
                for at, number in enumerate(numbers)
            )
            labels = tuple(f"joint{number}" for number in numbers)
            drives = quantity == "command"
            name = f"{self.topic}.{COMMANDS if drives else quantity}"
            groups += [Group(name, labels, unit, used, clock, stamp, drives=drives)] if used else []
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
    ticks_ns = (1e9, 1e6, 1e3, 1.0)  # in what a number may count: s, ms, µs, ns
    tick = 1.0 if column.is_time else ticks_ns[0]
    span, heard_ns = (float(max(usable) - min(usable)) if usable else 0.0), float(np.ptp(log_ns))
    if not column.is_time and span and heard_ns:
        best = min(ticks_ns, key=lambda unit: abs(np.log(span * unit / heard_ns)))
        # By so much may it be longer or shorter than on the log's own clock, to be the same.
        tick = best if 1 / 3.0 < span * best / heard_ns < 3.0 else tick
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

    def __init__(self, path: Path, options: ReadOptions, decoders: Decoders) -> None:
        self._path = path
        self._options = options
        self._decoders = decoders
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
            rows = UserColumnRows(self._path, channel, picks, self._decoders.any_type(channel))
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
                missed = (one for at, one in self._missed.items() if _behind(text, at) is not None)
                raise next(missed, None) or self._no_topic(target, text)
        # Each group of columns comes from one topic.
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

    def _no_topic(self, target: str, text: str) -> LogError:
        topics = list(dict.fromkeys(channel.topic for channel in self._channels))
        example = ""
        for channel in self._channels:
            try:
                structure = self._decoders.any_type(channel).structure
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
