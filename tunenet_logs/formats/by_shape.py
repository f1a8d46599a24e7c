"""Extract positions from messages of unknown types, by the names and shapes of their fields.

`any_type` decodes a message by the definition in the log, or a JSON message by its own content.
`shape_reader` finds what in it is a measured position, or says why that is ambiguous: then the user
chooses with `--columns`. `ShapeMessages` does so for the messages of one channel.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from tunenet_logs.formats.base import (
    DAMAGED,
    NUMBERS,
    Decode,
    Listed,
    MessageError,
    Node,
    Plain,
    RawChannel,
    Structure,
    UnusableError,
    described,
    likely_field,
    numbers_in,
    time_ns,
)
from tunenet_logs.formats.compressed import MAX_PART_BYTES
from tunenet_logs.formats.decoders import (
    MAX_REPEATED_BYTES,
    MAX_SCHEMA_BYTES,
    any_json,
    descriptor_of,
    has_lists,
)
from tunenet_logs.formats.message_types import PositionSample, type_key
from tunenet_logs.formats.ros import SCHEMA_ENCODINGS, any_ros_type, known_types, parsed, ros_name

if TYPE_CHECKING:
    from google.protobuf.descriptor import Descriptor, FieldDescriptor

_MAX_TYPE_DEPTH = 8  # of parts within parts that are looked at: a type may hold itself
_MAX_NODES = 5000  # parts of a type that are looked at
# Time to read a byte of IDL and of protobuf, relative to one of another definition.
_IDL_WEIGHT, _PROTOBUF_WEIGHT = 8.0, 1 / 16

_WEIGHTS = {"ros2idl": _IDL_WEIGHT, "omgidl": _IDL_WEIGHT, "protobuf": _PROTOBUF_WEIGHT}

# Where a part of a message is: names of fields, and numbers in lists from 0.
Steps = tuple[str | int, ...]


@dataclass
class SchemaBudget:
    """Bytes of untrusted definitions that may be read in one log.

    Attributes:
        left_bytes: of definitions.
        left_guesses: bytes of messages that may be decoded to infer their structure.
    """

    left_bytes: int = 2 * 1024 * 1024
    left_guesses: int = 4 * 1024 * 1024

    def spend(self, channel: RawChannel) -> None:
        """Charge the definition of a channel's type to the budget.

        Raises:
            UnusableError: the budget is exhausted.
        """
        weight = _WEIGHTS.get(channel.schema_encoding, 1.0)
        count = int(weight * len(channel.schema))
        if count > self.left_bytes:
            raise UnusableError("the log has more definitions than are read")
        self.left_bytes -= count


@dataclass(frozen=True)
class AnyType:
    """Structure and decoder of the messages of one type.

    Attributes:
        structure: fields of the type; None where only a message shows them (JSON).
        decode: decoder of one message.
        checks_presence: whether an absent field reads as zero, as in protobuf.
    """

    structure: Structure | None
    decode: Decode
    checks_presence: bool = False

    def getter(self, steps: Steps) -> Callable[[Any], Any]:
        """Return a function that gets the field at ``steps`` of a message.

        The function raises LookupError or AttributeError where it is absent.
        """
        if self.checks_presence:
            return lambda message: _present(message, steps)
        if steps and not any(isinstance(step, int) or "." in step for step in steps):
            return attrgetter(".".join(map(str, steps)))
        return lambda message: _at(message, steps)


def _at(message: Any, steps: Steps) -> Any:
    for step in steps:
        message = message[step] if isinstance(step, int) else getattr(message, step)
    return message


def _present(message: Any, steps: Steps) -> Any:
    for step in steps:
        if isinstance(step, int):
            message = message[step]
            continue
        field = message.DESCRIPTOR.fields_by_name[step]
        if field.has_presence and not message.HasField(step):
            raise LookupError(f"it has no {step}")
        message = getattr(message, step)
    return message


def any_type(channel: RawChannel, budget: SchemaBudget) -> AnyType:
    """Return structure and decoder of a channel's messages of any type.

    Raises:
        UnusableError: their encoding or definition is not supported.
    """
    budget.spend(channel)
    if channel.encoding in SCHEMA_ENCODINGS:
        return _ros(channel)
    if channel.encoding == "protobuf" and channel.schema_encoding == "protobuf":
        return _protobuf(channel)
    if channel.encoding == "json":
        return AnyType(None, any_json)
    raise UnusableError(f"message encoding {channel.encoding[:20]!r} is not read")


def _ros(channel: RawChannel) -> AnyType:
    name, is_ros1 = ros_name(channel.type_name), channel.encoding == "ros1"
    types = dict(known_types(is_ros1=is_ros1))
    encodings = SCHEMA_ENCODINGS[channel.encoding]
    if channel.schema_encoding in encodings:
        types |= parsed(channel.schema, channel.schema_encoding, name)
        plain = channel.type_name.replace("::", "/")
        name = name if name in types or plain not in types else plain
    elif name not in types and channel.schema_encoding:
        raise UnusableError(
            f"its definition is in {channel.schema_encoding[:20]!r}, which is not read "
            f"(only {', '.join(encodings)})"
        )
    elif name not in types:
        raise UnusableError("its type is not known here, and the log does not define it")
    structure, decode = any_ros_type(types, name, is_ros1=is_ros1)
    return AnyType(structure, decode)


def _protobuf(channel: RawChannel) -> AnyType:
    if len(channel.schema) > MAX_SCHEMA_BYTES:
        raise UnusableError("its schema is too large")
    from google.protobuf.message import Error
    from google.protobuf.message_factory import GetMessageClass

    try:
        descriptor = descriptor_of(channel.schema, channel.type_name)
        structure = _Proto().structure(descriptor, 0)
        parse = GetMessageClass(descriptor).FromString
        most = MAX_REPEATED_BYTES if has_lists(descriptor) else MAX_PART_BYTES
    except (Error, *DAMAGED) as error:
        raise UnusableError(f"its schema is damaged: {described(error)}") from error

    def decode(data: bytes | memoryview) -> Any:
        if len(data) > most:
            raise MessageError(f"a message of {len(data)} bytes is over the limit of {most}")
        try:
            return parse(bytes(data))
        except (Error, *DAMAGED) as error:
            raise MessageError(f"a message is damaged: {described(error)}") from error

    return AnyType(structure, decode, checks_presence=True)


class _Proto:
    """Structure of a protobuf type, bounded in depth and in number of fields."""

    def __init__(self) -> None:
        self._nodes = 0

    def structure(self, descriptor: Descriptor, depth: int) -> Structure:
        fields = {field.name: self._field(field, depth) for field in descriptor.fields}
        return Structure(descriptor.full_name, fields)

    def _field(self, field: FieldDescriptor, depth: int) -> Node:
        self._nodes += 1
        one = self._one(field, depth)
        return Listed(one) if field.is_repeated else one

    def _one(self, field: FieldDescriptor, depth: int) -> Node:
        if field.message_type is not None:
            is_map = field.message_type.GetOptions().map_entry
            if is_map or depth > _MAX_TYPE_DEPTH or self._nodes > _MAX_NODES:
                return Plain.OTHER
            return self.structure(field.message_type, depth + 1)
        if field.type in (field.TYPE_DOUBLE, field.TYPE_FLOAT):
            return Plain.NUMBER
        if field.type == field.TYPE_STRING:
            return Plain.TEXT
        if field.type == field.TYPE_BOOL:
            return Plain.FLAG
        return Plain.OTHER if field.type == field.TYPE_BYTES else Plain.WHOLE


def structure_of(message: Any) -> Structure:
    """Infer the structure of a decoded JSON message from its values."""
    node = _node(message, [0], 0)
    return node if isinstance(node, Structure) else Structure("", {})


def _node(value: Any, seen: list[int], depth: int) -> Node:
    seen[0] += 1
    if depth > _MAX_TYPE_DEPTH or seen[0] > _MAX_NODES:
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

# Fields that lead to where something is.
_WORDS = frozenset(
    [
        "pose",
        "position",
        "point",
        "translation",
        "transform",
        "pose_stamped",
        "location",
        "odometry",
        "odom",
        "pos",
        "center",
        "centroid",
        "bbox",
        "coordinates",
    ]
)

# What lists of bare points are called, without an s.
_LISTS = _WORDS | frozenset(
    [
        "marker",
        "object",
        "ball",
        "track",
        "detection",
        "body",
        "bodies",
        "entity",
        "target",
        "obstacle",
    ]
)

# Packages whose types are said to be in metres.
_IN_METRES = frozenset(
    [
        "geometry_msgs",
        "nav_msgs",
        "tf2_msgs",
        "visualization_msgs",
        "vision_msgs",
        "gazebo_msgs",
        "foxglove",
    ]
)

# How types begin whose positions are planned, maps, clouds, or directions.
_NOT_MEASURED = [
    "nav_msgs/msg/Path",
    "sensor_msgs/",
    "trajectory_msgs/",
    "moveit_msgs/",
    "shape_msgs/",
    "map_msgs/",
    "geometry_msgs/msg/Vector3",
    "geometry_msgs/msg/Quaternion",
    "geometry_msgs/msg/Polygon",
    "visualization_msgs/msg/InteractiveMarker",
    "nav_msgs/msg/Map",
    "rcl_interfaces/",
    "tunenet_msgs/",
    "foxglove.PointCloud",
    "foxglove.LaserScan",
    "foxglove.Grid",
    "foxglove.Scene",
    "foxglove.VoxelGrid",
    "foxglove.Log",
    "foxglove.CameraCalibration",
]

# Flags of an object, with their value where it is not seen.
_UNSEEN = {"occluded": True, "is_occluded": True}
_UNSEEN |= dict.fromkeys(
    ("tracking_valid", "is_tracking_valid", "tracked", "is_tracked", "valid", "is_valid"), False
)
_UNSEEN |= dict.fromkeys(("visible", "is_visible"), False)
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
    return not type_key(type_name).startswith(tuple(_NOT_MEASURED))


def unit_of(type_name: str) -> str:
    """Return the unit of a type's positions: "m", or "" where it is unstated."""
    name = type_key(type_name)
    return "m" if name.replace(".", "/").partition("/")[0] in _IN_METRES else ""


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
    """Build the reader of positions of a type, or say why there is none ("" without any evidence).

    Args:
        kind: structure and decoder of the messages.
        top: their structure.
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
        if node.of.is_place and name.lower().removesuffix("s") not in _LISTS:
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
        if name.lower() in _WORDS
        for rest in _places(inner, depth - 1)
    ]


def _thing(kind: AnyType, node: Structure, place: Steps) -> _Thing:
    fields = node.fields

    def getters(of: Callable[[str, Node], bool]) -> tuple[Get, ...]:
        return tuple(kind.getter((name,)) for name, inner in fields.items() if of(name, inner))

    at: Node = node
    for step in place:
        assert isinstance(at, Structure)
        assert isinstance(step, str)
        at = at.fields[step]
    stamp = stamp_steps(node)
    is_marker = "action" in fields and "ns" in fields
    return _Thing(
        place=kind.getter(place) if place else lambda entry: entry,
        is_list=isinstance(at, Listed),
        names=getters(_is_name),
        numbers=getters(_is_number),
        indices=getters(lambda name, inner: name.endswith("index") and inner is Plain.WHOLE),
        unseen=tuple(
            (kind.getter((name,)), _UNSEEN[name])
            for name, inner in fields.items()
            if name in _UNSEEN and inner is Plain.FLAG
        ),
        stamp=kind.getter(stamp) if stamp else None,
        action=kind.getter(("action",)) if is_marker else None,
    )


def _is_name(name: str, node: Node) -> bool:
    is_told = name in ("name", "ns", "child_frame_id", "label", "subject", "id")
    return node is Plain.TEXT and (is_told or name.endswith("_name"))


def _is_number(name: str, node: Node) -> bool:
    number = node.of if isinstance(node, Listed) else node
    return number is Plain.WHOLE and (name == "id" or name.endswith("_id"))


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
    """Reader of one channel's messages, by `ShapeReader`.

    Args:
        kind: structure and decoder of the type.
        reader: reader of their positions; None where only a message tells.
        top: structure of the messages.
        budget: for messages that are decoded only to infer their structure.
    """

    def __init__(
        self,
        kind: AnyType,
        reader: ShapeReader | None,
        top: Structure | None,
        budget: SchemaBudget,
    ) -> None:
        self._budget = budget
        self._kind = kind
        self._reader = reader
        self._tries = _TRIES
        self._why = ""
        self._top = top
        self._stamp = kind.getter(steps) if top and (steps := stamp_steps(top)) else None

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
        try:
            return self._kind.decode(data)
        except MessageError:
            return None

    def read(self, message: Any) -> Iterable[PositionSample]:
        """Return the positions of a message.

        Raises:
            ValueError, TypeError, AttributeError: its content is invalid.
        """
        reader = self._reader or self._told_by(message)
        if reader is None or message is None:
            return ()
        try:
            stamp_ns = time_ns(self._stamp(message)) if self._stamp is not None else 0
        except LookupError:
            stamp_ns = 0
        return reader(message, stamp_ns)

    def _told_by(self, message: Any) -> ShapeReader | None:
        if message is None:
            return None
        top = structure_of(message)
        self._top = top
        reader = shape_reader(self._kind, top)
        if isinstance(reader, str):
            self._why = self._why or reader
            return None
        if steps := stamp_steps(top):
            self._stamp = self._kind.getter(steps)
        self._reader = reader
        return reader

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
        return ShapeMessages(kind, None, None, budget)
    reader = shape_reader(kind, kind.structure)
    if isinstance(reader, str):
        if reader:
            raise UnusableError(f"{reader}; {_choose(channel.topic, kind.structure)}")
        return None
    return ShapeMessages(kind, reader, kind.structure, budget)


def _choose(topic: str, top: Structure | None) -> str:
    """Return the option to type where the shape alone is ambiguous."""
    fields = numbers_in(top) if top else []
    field = likely_field(fields) if fields else "FIELD"
    return f"choose one with --columns z={topic}.{field}"
