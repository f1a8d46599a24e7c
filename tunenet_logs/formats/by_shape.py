"""Extract positions from messages of unknown types, by the names of their fields."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tunenet_logs.formats.any_messages import AnyType, Steps
from tunenet_logs.formats.message_types import type_key
from tunenet_logs.formats.position_types import PositionSample
from tunenet_logs.formats.stamps import time_ns
from tunenet_logs.formats.structure import NUMBERS, Listed, Node, Plain, Structure

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

_UNSEEN = {"occluded": True, "is_occluded": True}
_UNSEEN |= dict.fromkeys(
    ("tracking_valid", "is_tracking_valid", "tracked", "is_tracked", "valid", "is_valid"), False
)
_UNSEEN |= dict.fromkeys(("visible", "is_visible"), False)
"""Flags of things, and what they are where it is not seen."""

_DELETED = (2, 3)  # `action` of a marker that is taken away
_MAX_DEPTH = 6  # of fields within fields
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
    if places := _places(top, _MAX_DEPTH):
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
        places = _places(node.of, _MAX_DEPTH - 1)
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
