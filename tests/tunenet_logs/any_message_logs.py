"""Logs of messages of any type, for tests: written by the libraries alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_NS = 1_700_000_000_000_000_000
STEP_NS = 10_000_000


def height(index: int) -> float:
    """Of something at a message, so that each differs."""
    return 1.5 - 0.01 * index


class RosLog:
    """Builds messages of types given as text, and logs them."""

    def __init__(self, definitions: Mapping[str, str], *, is_ros1: bool = False) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
        for name, text in definitions.items():
            self.store.register(get_types_from_msg(text, name))

    def make(self, kind: str, **fields: Any) -> Any:
        """A message; lists of numbers become arrays."""
        values = {
            name: np.array(value, np.float64) if _is_numbers(value) else value
            for name, value in fields.items()
        }
        return self.store.types[kind](**values)

    def point(self, x: float, y: float, z: float) -> Any:
        """A geometry_msgs/Point."""
        return self.make("geometry_msgs/msg/Point", x=x, y=y, z=z)

    def pose(self, x: float, y: float, z: float) -> Any:
        """A geometry_msgs/Pose."""
        turn = self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        return self.make("geometry_msgs/msg/Pose", position=self.point(x, y, z), orientation=turn)

    def header(self, index: int) -> Any:
        """A header whose stamp is 2 ms before the message is heard."""
        stamp_ns = START_NS + index * STEP_NS - 2_000_000
        stamp = self.make(
            "builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
        )
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="world")

    def definition(self, kind: str) -> bytes:
        """Of a type with all that it is made of, as a log carries it."""
        return self.store.generate_msgdef(kind, ros_version=2)[0].encode()

    def write(self, path: Path, topics: Mapping[str, tuple[str, Sequence[Any]]]) -> Path:
        """A log of messages, by topic with their type."""
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(profile="ros2")
            for topic, (kind, messages) in topics.items():
                text = self.definition(kind)
                schema = writer.register_schema(kind, "ros2msg", text)
                channel = writer.register_channel(topic, "cdr", schema)
                for index, message in enumerate(messages):
                    data = bytes(self.store.serialize_cdr(message, kind))
                    stamp_ns = START_NS + index * STEP_NS
                    writer.add_message(channel, stamp_ns, data, stamp_ns)
            writer.finish()
        return path


def write_json(path: Path, topic: str, kind: str, messages: Sequence[Any]) -> Path:
    """A log of messages of JSON without a schema."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(kind, "jsonschema", b"{}")
        channel = writer.register_channel(topic, "json", schema)
        for index, message in enumerate(messages):
            stamp_ns = START_NS + index * STEP_NS
            writer.add_message(channel, stamp_ns, json.dumps(message).encode(), stamp_ns)
        writer.finish()
    return path


def write_raw(path: Path, topic: str, kind: str, definition: bytes, data: bytes) -> Path:
    """A log of one message, and of a definition as it is given."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2msg", definition)
        channel = writer.register_channel(topic, "cdr", schema)
        writer.add_message(channel, START_NS, data, START_NS)
        writer.finish()
    return path


def _is_numbers(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], float)
