"""Extract positions from messages of unknown types, by the names and shapes of their fields.

`shape_reader` finds what in a type is a measured position, or says why that is ambiguous: then the
user chooses with `--columns`. `ShapeMessages` does so for the messages of one channel.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

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
    likely_field,
    node_at,
    numbers_in,
    time_ns,
    type_key,
)
from tunenet_logs.formats.decoders import MAX_TYPE_DEPTH, SchemaBudget, any_type
from tunenet_logs.formats.message_types import PositionSample
from tunenet_logs.formats.ros import SCHEMA_ENCODINGS


def structure_of(message: Any) -> Structure:
    """Infer the structure of a decoded JSON message from its values."""
    node = _node(message, [0], 0)
    return node if isinstance(node, Structure) else Structure("", {})


def _node(value: Any, seen: list[int], depth: int) -> Node:
    seen[0] += 1
    if depth > MAX_TYPE_DEPTH or seen[0] > MAX_NODES:
        return Plain.OTHER
    if isinstance(value, SimpleNamespace):
        fields = {name: _node(one, seen, depth + 1) for name, one in vars(value).items()}
        return Structure("", fields)
    if isinstance(value, list):
        of = _node(value[0], seen, depth + 1) if value else Plain.OTHER
        return Listed(of, None if isinstance(of, Structure) else len(value))
    if isinstance(value, bool):
        return Plain.FLAG
    if isinstance(value, int | float):
        return Plain.WHOLE if isinstance(value, int) else Plain.NUMBER
    return Plain.TEXT if isinstance(value, str) else Plain.OTHER


# ---- `ShapeReader`: find the positions in messages of one type.

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
_DELETED = (2, 3)  # `action` of a marker that is taken away
_MAX_PLACE_DEPTH = 6  # of fields within fields, down to a position
_MAX_THINGS = 100  # of one topic: more are no bodies, but a drawing
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


def may_hold_positions(type_name: str) -> bool:
    """Return whether positions of a type may be measured, not planned, mapped or directions."""
    return not _NOT_MEASURED.match(type_key(type_name))


def unit_of(type_name: str) -> str:
    """Return the unit of a type's positions: "m", or "" where it is unstated."""
    return "m" if _IN_METRES.match(type_key(type_name)) else ""


class ShapeReader:
    """Reader of the positions in messages of one type.

    Attributes:
        doubled: entries left out because another of the same message has their name.
        refused: why the type is not used; "" where it is.
    """

    def __init__(self, things: Sequence[tuple[str, Get | None, Get | None, _Thing]]) -> None:
        self._things = things
        self._counts: dict[str, int] = {}
        self._seen: set[str] = set()
        self.doubled = 0
        self.refused = ""

    def __call__(self, message: Any, stamp_ns: int) -> Iterable[PositionSample]:
        """Return the positions in a message; `stamp_ns` is its own stamp, 0 where it has none."""
        if self.refused:
            return ()
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
        if len(self._seen) > _MAX_THINGS:
            self.refused = f"it holds over {_MAX_THINGS} things"
        return () if self.refused else found

    def _told_apart(self, names: list[str], label: str) -> list[str]:
        """Return unique names: indices where unnamed, "" for duplicates, which are left out."""
        if not any(names):
            if names and self._counts.setdefault(label, len(names)) != len(names):
                self.refused = "its entries have no names, and their number changes"
            return [str(number) for number in range(len(names))]
        counts = Counter(names)
        once = [name if counts[name] == 1 else "" for name in names]
        self.doubled += once.count("")
        return once


def _samples(thing: _Thing, entry: Any, name: str, stamp_ns: int) -> list[PositionSample]:
    if any(bool(get(entry)) is value for get, value in thing.unseen):
        return []
    if thing.action is not None and thing.action(entry) in _DELETED:
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


def shape_reader(kind: AnyType, top: Structure) -> ShapeReader | str:
    """Build the reader of positions of a type of structure `top`.

    Where there is none, return why, or "" without any evidence.
    """
    if places := _places(top, _MAX_PLACE_DEPTH):
        if len(places) > 1:
            shown = ", ".join(".".join(map(str, place)) for place in places[:3])
            return f"it names several positions ({shown})"
        thing = _thing(kind, top, places[0])
        # The number of a message by itself may count messages; a marker's is a part of its name.
        thing = thing if thing.action else replace(thing, numbers=(), indices=())
        return ShapeReader([("", None, None, thing)])
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
    if not lists:
        return ""
    if len(lists) == 1:
        return ShapeReader([("", *lists[0][1:])])
    return ShapeReader([(f"{name}.", *rest) for name, *rest in lists])  # type: ignore[misc]


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
        names=getters(
            lambda name, inner: inner is Plain.TEXT and bool(_NAME.fullmatch(name)),
        ),
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
_TRIES = 100  # JSON messages that may leave their shape open, as an empty list does


class ShapeMessages:
    """Reader of one channel's messages, by `ShapeReader`; where none is given, a message tells."""

    def __init__(self, kind: AnyType, reader: ShapeReader | None, budget: SchemaBudget) -> None:
        self._budget = budget
        self._kind = kind
        self._reader = reader
        self._tries = _TRIES
        self._why = ""
        self._top = kind.structure
        self._stamp = self._stamp_getter()

    def _stamp_getter(self) -> Get | None:
        steps = stamp_steps(self._top) if self._top else ()
        return self._kind.getter(steps) if steps else None

    def decode(self, data: bytes | memoryview) -> Any:
        """Decode a message; None where it is unreadable and its shape still unknown.

        Raises:
            MessageError: it is damaged.
        """
        if self._reader is not None:
            return None if self._reader.refused else self._kind.decode(data)
        if not self._tries or self._budget.left_guesses < len(data):
            return None
        self._tries -= 1
        self._budget.left_guesses -= len(data)
        with suppress(MessageError):
            return self._kind.decode(data)
        return None

    def read(self, message: Any) -> Iterable[PositionSample]:
        """Return the positions of a message; its content may raise DAMAGED."""
        if message is None:
            return ()
        if self._reader is None:
            self._top = structure_of(message)
            reader = shape_reader(self._kind, self._top)
            if isinstance(reader, str):
                self._why = self._why or reader
                return ()
            self._reader, self._stamp = reader, self._stamp_getter()
        try:
            stamp_ns = time_ns(self._stamp(message)) if self._stamp is not None else 0
        except LookupError:
            stamp_ns = 0
        return self._reader(message, stamp_ns)

    def outcome(self, topic: str) -> tuple[str, list[str]]:
        """Return why the channel is not used ("" where it is), and notes on it."""
        why = self._reader.refused if self._reader else self._why
        if why:
            return f"{why}; {_choose(topic, self._top)}", []
        if self._reader is None:
            return UNUSED, []
        if self._reader.doubled:
            why = f"{self._reader.doubled} entries were left out that share their name with another"
            return "", [f"{topic}: {why}"]
        return "", []


def shape_messages(channel: RawChannel, budget: SchemaBudget) -> ShapeMessages | None:
    """Return a reader of a channel by the shape of its messages; None without any evidence.

    Raises:
        UnusableError: its positions are ambiguous: the user has to choose the columns.
    """
    is_json = channel.encoding == "json"
    hinted = is_json or not channel.schema or _HINT.search(channel.schema)
    if not hinted or not may_hold_positions(channel.type_name):
        return None
    try:
        kind = any_type(channel, budget)
    except UnusableError:
        known = SCHEMA_ENCODINGS.get(channel.encoding)
        if known and channel.schema_encoding and channel.schema_encoding not in known:
            raise  # it may well be a type that a task uses
        return None
    if kind.structure is None:
        return ShapeMessages(kind, None, budget)
    reader = shape_reader(kind, kind.structure)
    if isinstance(reader, str):
        if reader:
            raise UnusableError(f"{reader}; {_choose(channel.topic, kind.structure)}")
        return None
    return ShapeMessages(kind, reader, budget)


def _choose(topic: str, top: Structure | None) -> str:
    """Return the option to type where the shape alone is ambiguous."""
    fields = numbers_in(top) if top else []
    field = likely_field(fields) if fields else "FIELD"
    return f"choose one with --columns z={topic}.{field}"
