"""Episodes and logs by others: made here with no code of the project."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_typestore

POSE = "geometry_msgs/msg/PoseStamped"
TOPIC = "/vrpn/thing/pose"
Stamps = np.ndarray | list[int]


def bounce_heights(
    restitution: float, gap_m: float, times_s: np.ndarray, gravity: float = 9.81
) -> np.ndarray:
    """Height under a ball [m] at times after its release, in closed form."""
    speed = np.sqrt(2 * gravity * gap_m)
    times = np.maximum(times_s, 0.0)
    heights = np.maximum(gap_m - gravity / 2 * times**2, 0.0)
    start, up = speed / gravity, restitution * speed
    while up > 1e-3 and start < times[-1]:
        here = (times >= start) & (times < start + 2 * up / gravity)
        since = times[here] - start
        heights[here] = up * since - gravity / 2 * since**2
        start, up = start + 2 * up / gravity, restitution * up
    return heights


@dataclass(frozen=True)
class Stranger:
    """A drop as another laboratory's tracker would record it."""

    restitution: float
    gap_m: float = 1.0
    rate_hz: float = 120.0
    hold_s: float = 1.0
    seconds: float = 4.0
    noise_m: float = 0.001
    table_m: float = 0.37
    seed: int = 0
    up: str = "z"
    start_ns: int = 1_700_000_000_123_456_789

    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Stamps [ns], shape (T,), and positions [m], shape (T, 3)."""
        rng = np.random.default_rng(self.seed)
        times = np.arange(int((self.hold_s + self.seconds) * self.rate_hz)) / self.rate_hz
        heights = bounce_heights(self.restitution, self.gap_m, times - self.hold_s) + self.table_m
        columns = {"x": 0.11 * np.ones_like(times), "y": -0.2 + 0.01 * times, "z": 0 * times + 0.3}
        columns[self.up] = heights
        positions = np.column_stack([columns[name] for name in "xyz"])
        positions += rng.normal(0, self.noise_m, positions.shape)
        return self.start_ns + np.round(times * 1e9).astype(np.int64), positions


def _pose(types: Any, stamp_ns: int, position: np.ndarray, **more: Any) -> Any:
    """A PoseStamped; `more` goes into its header."""
    seconds, nanoseconds = divmod(int(stamp_ns), 1_000_000_000)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    place = types["geometry_msgs/msg/Point"](*(float(one) for one in position))
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    return types[POSE](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="map", **more),
        pose=types["geometry_msgs/msg/Pose"](position=place, orientation=turn),
    )


def write_poses(
    path: Path,
    stamps_ns: Stamps,
    positions: np.ndarray,
    topic: str = TOPIC,
    compression: CompressionType = CompressionType.LZ4,
    set_header: bool = True,
    chunk_bytes: int = 1024 * 1024,
) -> None:
    """A log of PoseStamped as a recorder of another distribution writes it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_bytes, compression=compression)
        writer.start(profile="ros2", library="somebody's recorder")
        text = store.generate_msgdef(POSE, ros_version=2)[0].encode()
        schema = writer.register_schema(POSE, "ros2msg", text)
        channel = writer.register_channel(topic, "cdr", schema)
        for stamp, position in zip(stamps_ns, positions, strict=True):
            message = _pose(types, int(stamp) if set_header else 0, position)
            data = bytes(store.serialize_cdr(message, POSE))
            writer.add_message(channel, int(stamp), data, int(stamp))
        writer.finish()


def write_ros1(
    path: Path, stamps_ns: np.ndarray, positions: np.ndarray, topic: str = TOPIC
) -> None:
    """The same in the encoding of ROS 1, as `mcap convert` makes it of a bag."""
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros1", library="somebody's converter")
        text = store.generate_msgdef(POSE, ros_version=1)[0].encode()
        schema = writer.register_schema("geometry_msgs/PoseStamped", "ros1msg", text)
        channel = writer.register_channel(topic, "ros1", schema)
        for count, (stamp, position) in enumerate(zip(stamps_ns, positions, strict=True)):
            message = _pose(types, int(stamp), position, seq=count)
            data = bytes(store.serialize_ros1(message, POSE))
            writer.add_message(channel, int(stamp), data, int(stamp))
        writer.finish()


def write_protobuf(
    path: Path, stamps_ns: np.ndarray, positions: np.ndarray, topic: str = TOPIC
) -> None:
    """The same as foxglove.PoseInFrame in protobuf, by Foxglove's own writer."""
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
    from mcap_protobuf.writer import Writer as ProtobufWriter

    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for stamp, (x, y, z) in zip(stamps_ns, positions, strict=True):
            message = PoseInFrame(frame_id="map")
            message.timestamp.FromNanoseconds(int(stamp))
            message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, z
            message.pose.orientation.w = 1
            writer.write_message(topic, message, int(stamp), int(stamp))


def write_json(
    path: Path, stamps_ns: np.ndarray, positions: np.ndarray, topic: str = TOPIC
) -> None:
    """The same as foxglove.PoseInFrame in JSON."""
    messages = [
        {
            "timestamp": {"sec": int(stamp) // 10**9, "nsec": int(stamp) % 10**9},
            "frame_id": "map",
            "pose": {
                "position": {"x": float(x), "y": float(y), "z": float(z)},
                "orientation": {"x": 0, "y": 0, "z": 0, "w": 1},
            },
        }
        for stamp, (x, y, z) in zip(stamps_ns, positions, strict=True)
    ]
    write_texts(path, "foxglove.PoseInFrame", messages, topic, stamps_ns)


def write_texts(
    path: Path,
    type_name: str,
    messages: list,
    topic: str = "/any",
    stamps_ns: np.ndarray | None = None,
) -> None:
    """A log of JSON messages; bytes are taken as they are."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(type_name, "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel(topic, "json", schema)
        for count, message in enumerate(messages):
            stamp = 1000 + count if stamps_ns is None else int(stamps_ns[count])
            data = message if isinstance(message, bytes) else json.dumps(message).encode()
            writer.add_message(channel, stamp, data, stamp)
        writer.finish()


def write_table(path: Path, stamps_ns: np.ndarray, positions: np.ndarray) -> None:
    """The same as a table of decimal seconds."""
    rows = ["time,x,y,z"]
    for stamp, row in zip(stamps_ns, positions, strict=True):
        seconds, nanoseconds = divmod(int(stamp), 10**9)
        rows.append(f"{seconds}.{nanoseconds:09d}," + ",".join(repr(float(one)) for one in row))
    path.write_text("\n".join(rows) + "\n")


# Writers of the same positions, by the name of a file.
WRITERS: dict[str, Callable[[Path, np.ndarray, np.ndarray], None]] = {
    "cdr.mcap": write_poses,
    "ros1.mcap": write_ros1,
    "protobuf.mcap": write_protobuf,
    "json.mcap": write_json,
    "table.csv": write_table,
}


def without_chunks(source: Path, path: Path, *, chunks: bool = False, crcs: bool = True) -> None:
    """The same messages outside chunks, or in some that are not packed; with checksums or none."""
    with source.open("rb") as read, path.open("wb") as file:
        plain = CompressionType.NONE
        writer = Writer(
            file, use_chunking=chunks, compression=plain, enable_crcs=crcs, enable_data_crcs=crcs
        )
        writer.start("ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(read).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()


def write_poses_bag(
    path: Path,
    stamps_ns: Stamps,
    positions: np.ndarray,
    topic: str = TOPIC,
    compression: BagWriter.CompressionFormat | None = None,
    chunk_bytes: int = 16 * 1024,
) -> None:
    """The same as a ROS 1 bag."""
    store = get_typestore(Stores.ROS1_NOETIC)
    writer = BagWriter(path)
    if compression is not None:
        writer.set_compression(compression)
    writer.chunk_threshold = chunk_bytes
    with writer:
        connection = writer.add_connection(topic, POSE, typestore=store)
        for count, (stamp, position) in enumerate(zip(stamps_ns, positions, strict=True)):
            message = _pose(store.types, int(stamp), position, seq=count)
            writer.write(connection, int(stamp), bytes(store.serialize_ros1(message, POSE)))


def write_poses_folder(
    path: Path,
    stamps_ns: Stamps,
    positions: np.ndarray,
    topic: str = TOPIC,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    """The same as a ROS 2 bag's folder; gives the one file in it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = FolderWriter(path, version=9, storage_plugin=storage)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(topic, POSE, typestore=store)
        for stamp, position in zip(stamps_ns, positions, strict=True):
            message = _pose(store.types, int(stamp), position)
            writer.write(connection, int(stamp), bytes(store.serialize_cdr(message, POSE)))
    return next(one for one in path.iterdir() if one.name != "metadata.yaml")


def foxglove(name: str) -> Any:
    """A type of Foxglove's in protobuf."""
    module = __import__(f"foxglove_schemas_protobuf.{name}_pb2", fromlist=[name])
    return getattr(module, name)
