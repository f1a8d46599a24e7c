"""Logs of messages in every encoding, written by the libraries alone: no code of the project."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import ArrayLike
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
NUMBERS = "std_msgs/msg/Float64MultiArray"
NUMBER = "std_msgs/msg/Float64"
WRENCH = "geometry_msgs/msg/WrenchStamped"
JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"

START_NS = 1_700_000_000_000_000_000  # when the first message of a log is received
STEP_NS = 10_000_000
# Topic, type, when it is received after `START_NS` [ns], and the fields of one message.
Sent = tuple[str, str, int, Any]


class Schema(NamedTuple):
    """What a channel of MCAP says of its messages."""

    kind: str
    form: str = "ros2msg"
    text: bytes = b""
    encoding: str = "cdr"


# Fields of messages.
def time_of(stamp_ns: int) -> dict[str, int]:
    """A time or duration."""
    return {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}


def header(stamp_ns: int, frame: str = "") -> dict[str, Any]:
    return {"stamp": time_of(stamp_ns), "frame_id": frame}


def xyz(place: ArrayLike) -> dict[str, float]:
    return dict(zip("xyz", np.asarray(place, float).tolist(), strict=True))


def pose(
    stamp_ns: int, position_m: ArrayLike, turn: ArrayLike = (0, 0, 0, 1), frame: str = ""
) -> dict[str, Any]:
    """A position, and an orientation as a quaternion x, y, z, w."""
    how = dict(zip("xyzw", np.asarray(turn, float).tolist(), strict=True))
    both = {"position": xyz(position_m), "orientation": how}
    return {"header": header(stamp_ns, frame), "pose": both}


def transform(
    stamp_ns: int, position_m: ArrayLike, turn: ArrayLike, frame: str, child: str
) -> dict[str, Any]:
    """Where one frame is in another."""
    both = pose(stamp_ns, position_m, turn)["pose"]
    moved = {"translation": both["position"], "rotation": both["orientation"]}
    return {"header": header(stamp_ns, frame), "child_frame_id": child, "transform": moved}


def wrench(
    stamp_ns: int, force_n: ArrayLike, torque_nm: ArrayLike, frame: str = ""
) -> dict[str, Any]:
    both = {"force": xyz(force_n), "torque": xyz(torque_nm)}
    return {"header": header(stamp_ns, frame), "wrench": both}


def point(after_ns: int, position: Sequence = (), velocity: Sequence = (), effort: Sequence = ()):
    """A point of a trajectory."""
    return {
        "positions": list(position),
        "velocities": list(velocity),
        "accelerations": [],
        "effort": list(effort),
        "time_from_start": time_of(after_ns),
    }


def trajectory(stamp_ns: int, names: Sequence[str], *points: dict[str, Any]) -> dict[str, Any]:
    """A trajectory; stamp 0 for one that starts when it arrives."""
    return {"header": header(stamp_ns), "joint_names": list(names), "points": list(points)}


def numbers(*values: float) -> dict[str, Any]:
    """Numbers without a layout."""
    return {"layout": {"dim": [], "data_offset": 0}, "data": list(values)}


def in_steps(topic: str, kind: str, messages: Iterable[Any]) -> list[Sent]:
    """Messages of one topic at an even rate."""
    return [(topic, kind, n * STEP_NS, fields) for n, fields in enumerate(messages)]


# Types of ROS.
@cache
def ros1() -> Any:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    return store


def ros2(types: Mapping[str, str] | None = None) -> Any:
    """The types of a distribution, and more by their definitions."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in (types or {}).items():
        store.register(get_types_from_msg(text, name))
    return store


def message(store: Any, kind: str, fields: Mapping[str, Any]) -> Any:
    """A message of a store's types; what has no value is 0 or empty."""
    defined = store.fielddefs[kind][1]
    values = {name: _value(store, node[0], node[1], fields.get(name)) for name, node in defined}
    return store.types[kind](**values)


def _value(store: Any, node: Nodetype, of: Any, value: Any) -> Any:
    if node == Nodetype.NAME:
        return message(store, of, value or {})
    if node == Nodetype.BASE:
        return value if value is not None else "" if of[0] == "string" else 0
    (inner, kind), count = of
    if inner == Nodetype.NAME:
        return [message(store, kind, one) for one in value or ()]
    if kind[0] == "string":
        return list(value or ())
    number = "uint8" if kind[0] in ("byte", "char", "octet") else kind[0]
    if isinstance(value, bytes):
        return np.frombuffer(value, number)
    if value is None:
        return np.zeros(count if node == Nodetype.ARRAY else 0, number)
    return np.array(value, number)


def as_cdr(store: Any, kind: str, fields: Mapping[str, Any]) -> bytes:
    return bytes(store.serialize_cdr(message(store, kind, fields), kind))


@cache
def definition(store: Any, kind: str, ros: int = 2) -> bytes:
    """Of a type with all that it is made of, as a log carries it."""
    return store.generate_msgdef(kind, ros_version=ros)[0].encode()


# Logs.
def write_raw(
    path: Path,
    sent: Iterable[tuple[str, Schema, int, bytes]],
    *,
    profile: str = "ros2",
    compression: CompressionType = CompressionType.LZ4,
    chunk_bytes: int = 2**20,
) -> Path:
    """MCAP of bytes: each with its topic, what it is, and when it came [ns]; 0 for no chunks."""
    schemas: dict[Schema, int] = {}
    channels: dict[tuple[str, Schema], int] = {}
    with path.open("wb") as file:
        writer = Writer(
            file, chunk_size=chunk_bytes, compression=compression, use_chunking=chunk_bytes > 0
        )
        writer.start(profile=profile, library="somebody's recorder")
        for topic, schema, at_ns, data in sent:
            if schema not in schemas:
                schemas[schema] = writer.register_schema(schema.kind, schema.form, schema.text)
            if (topic, schema) not in channels:
                number = writer.register_channel(topic, schema.encoding, schemas[schema])
                channels[topic, schema] = number
            writer.add_message(channels[topic, schema], at_ns, data, at_ns)
        writer.finish()
    return path


def write_cdr(
    path: Path,
    sent: Iterable[Sent],
    types: Mapping[str, str] | None = None,
    *,
    start_ns: int = START_NS,
    **container: Any,
) -> Path:
    """MCAP as a recorder of ROS 2 writes it."""
    store = ros2(types)

    def raw(topic: str, kind: str, at_ns: int, fields: Any) -> tuple[str, Schema, int, bytes]:
        schema = Schema(kind, text=definition(store, kind))
        return topic, schema, start_ns + at_ns, as_cdr(store, kind, fields)

    return write_raw(path, (raw(*one) for one in sent), **container)


def write_ros1(path: Path, sent: Iterable[Sent], *, start_ns: int = START_NS) -> Path:
    """MCAP in the encoding of ROS 1, as `mcap convert` makes it of a bag."""
    store = ros1()

    def raw(topic: str, kind: str, at_ns: int, fields: Any) -> tuple[str, Schema, int, bytes]:
        schema = Schema(kind.replace("/msg/", "/"), "ros1msg", definition(store, kind, 1), "ros1")
        data = bytes(store.serialize_ros1(message(store, kind, fields), kind))
        return topic, schema, start_ns + at_ns, data

    return write_raw(path, (raw(*one) for one in sent), profile="ros1")


def write_bag(
    path: Path,
    sent: Iterable[Sent],
    *,
    start_ns: int = START_NS,
    compression: BagWriter.CompressionFormat | None = None,
    chunk_bytes: int = 16 * 1024,
) -> Path:
    """A bag of ROS 1."""
    store = ros1()
    writer = BagWriter(path)
    if compression is not None:
        writer.set_compression(compression)
    writer.chunk_threshold = chunk_bytes
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, at_ns, fields in sent:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            data = bytes(store.serialize_ros1(message(store, kind, fields), kind))
            writer.write(connections[topic], start_ns + at_ns, data)
    return path


def write_folder(
    path: Path,
    sent: Iterable[Sent],
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    mode: CompressionMode = CompressionMode.NONE,
    *,
    start_ns: int = START_NS,
) -> Path:
    """A bag's folder of ROS 2."""
    store = ros2()
    writer = FolderWriter(path, version=9, storage_plugin=storage)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, at_ns, fields in sent:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], start_ns + at_ns, as_cdr(store, kind, fields))
    return path


def write_json(
    path: Path, sent: Iterable[Sent], *, start_ns: int = START_NS, **container: Any
) -> Path:
    """JSON with the types' names alone; bytes are taken as they are."""

    def raw(topic: str, kind: str, at_ns: int, fields: Any) -> tuple[str, Schema, int, bytes]:
        data = fields if isinstance(fields, bytes) else json.dumps(fields).encode()
        schema = Schema(kind, "jsonschema", b'{"type": "object"}', "json")
        return topic, schema, start_ns + at_ns, data

    return write_raw(path, (raw(*one) for one in sent), profile="", **container)


def write_protobuf(path: Path, sent: Iterable[tuple[str, int, Any]]) -> Path:
    """Foxglove's own writer of topics, times [ns] and messages."""
    from mcap_protobuf.writer import Writer as ProtobufWriter

    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for topic, at_ns, one in sent:
            writer.write_message(topic, one, at_ns, at_ns)
    return path


def foxglove(name: str) -> Any:
    """A type of Foxglove's in protobuf."""
    module = __import__(f"foxglove_schemas_protobuf.{name}_pb2", fromlist=[name])
    return getattr(module, name)


# By the name of a log.
WRITERS = {
    "cdr.mcap": write_cdr,
    "one.bag": write_bag,
    "folder": write_folder,
    "json.mcap": write_json,
}
