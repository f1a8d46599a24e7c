"""Logs of commands and forces in every encoding, written by the libraries alone."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tunenet_logs.episode import Array

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
NUMBERS = "std_msgs/msg/Float64MultiArray"
NUMBER = "std_msgs/msg/Float64"
WRENCH = "geometry_msgs/msg/WrenchStamped"
JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
TF = "tf2_msgs/msg/TFMessage"

START_NS = 1_700_000_000_000_000_000  # when the first message of a log is received
# Topic, type, when it is received after `START_NS` [ns], and the fields of one message.
Sent = tuple[str, str, int, dict[str, Any]]


def time_of(stamp_ns: int) -> dict[str, int]:
    """A time or duration."""
    return {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}


def header(stamp_ns: int, frame: str = "") -> dict[str, Any]:
    """A header."""
    return {"stamp": time_of(stamp_ns), "frame_id": frame}


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


def pose(
    stamp_ns: int,
    position_m: Sequence[float] | Array,
    turn: Sequence[float] | Array,
    frame: str = "",
) -> dict[str, Any]:
    """A position, and an orientation as a quaternion x, y, z, w."""
    where = dict(zip("xyz", map(float, position_m), strict=True))
    how = dict(zip("xyzw", map(float, turn), strict=True))
    return {"header": header(stamp_ns, frame), "pose": {"position": where, "orientation": how}}


def transform(
    stamp_ns: int,
    position_m: Sequence[float] | Array,
    turn: Sequence[float] | Array,
    frame: str,
    child: str,
) -> dict[str, Any]:
    """Where one frame is in another."""
    both = pose(stamp_ns, position_m, turn)["pose"]
    moved = {"translation": both["position"], "rotation": both["orientation"]}
    return {"header": header(stamp_ns, frame), "child_frame_id": child, "transform": moved}


def wrench(
    stamp_ns: int, force_n: Sequence[float], torque_nm: Sequence[float], frame: str = ""
) -> dict[str, Any]:
    """A force and a torque."""
    parts = {"force": force_n, "torque": torque_nm}
    axes = {name: dict(zip("xyz", values, strict=True)) for name, values in parts.items()}
    return {"header": header(stamp_ns, frame), "wrench": axes}


def write_cdr(path: Path, sent: Sequence[Sent]) -> Path:
    """By the MCAP project's own writer for ROS 2."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        schemas: dict[str, Any] = {}
        for topic, kind, at_ns, fields in sent:
            if kind not in schemas:
                text = store.generate_msgdef(kind, ros_version=2)[0]
                schemas[kind] = writer.register_msgdef(kind, text)
            writer.write_message(topic, schemas[kind], fields, START_NS + at_ns)
        writer.finish()
    return path


def write_ros1(path: Path, sent: Sequence[Sent]) -> Path:
    """A bag of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    with BagWriter(path) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, at_ns, fields in sent:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            data = bytes(store.serialize_ros1(_made(store, kind, fields), kind))
            writer.write(connections[topic], START_NS + at_ns, data)
    return path


def write_db3(path: Path, sent: Sequence[Sent]) -> Path:
    """A folder of ROS 2."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with FolderWriter(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections: dict[str, Any] = {}
        for topic, kind, at_ns, fields in sent:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            data = bytes(store.serialize_cdr(_made(store, kind, fields), kind))
            writer.write(connections[topic], START_NS + at_ns, data)
    return path


def write_json(path: Path, sent: Sequence[Sent]) -> Path:
    """JSON with the types' names alone."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for topic, kind, at_ns, fields in sent:
            if topic not in channels:
                schema = writer.register_schema(kind, "jsonschema", b'{"type": "object"}')
                channels[topic] = writer.register_channel(topic, "json", schema)
            stamp_ns = START_NS + at_ns
            writer.add_message(channels[topic], stamp_ns, json.dumps(fields).encode(), stamp_ns)
        writer.finish()
    return path


# By the name of a log.
DRIVEN_WRITERS = {
    "cdr.mcap": write_cdr,
    "one.bag": write_ros1,
    "folder": write_db3,
    "json.mcap": write_json,
}


def _made(store: Any, kind: str, fields: dict[str, Any]) -> Any:
    """A message of a store's types; what has no value is 0."""
    values: dict[str, Any] = {}
    for name, (node, inner) in store.fielddefs[kind][1]:
        value = fields.get(name, 0)
        if node == Nodetype.NAME:
            values[name] = _made(store, inner, value)
        elif node == Nodetype.SEQUENCE:
            (of, what), _ = inner
            if of == Nodetype.NAME:
                values[name] = [_made(store, what, one) for one in value]
            else:
                is_text = what[0] == "string"
                values[name] = list(value) if is_text else np.array(value, what[0])
        else:
            values[name] = value
    return store.types[kind](**values)
