"""Episodes and logs by others: made here with no code of the project."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from tests import message_logs as logs
from tests.message_logs import POSE, Sent, foxglove, pose

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


def poses(stamps_ns: Stamps, positions: np.ndarray, topic: str, has_stamps: bool = True):
    """Messages of PoseStamped, at the times of the log or with none."""
    for stamp, place in zip(map(int, stamps_ns), positions, strict=True):
        yield topic, POSE, stamp, pose(stamp if has_stamps else 0, place, frame="map")


def write_poses(
    path: Path,
    stamps_ns: Stamps,
    positions: np.ndarray,
    topic: str = TOPIC,
    compression: CompressionType = CompressionType.LZ4,
    set_header: bool = True,
    chunk_bytes: int = 2**20,
) -> None:
    """A log as a recorder of another distribution writes it."""
    sent = poses(stamps_ns, positions, topic, set_header)
    logs.write_cdr(path, sent, start_ns=0, compression=compression, chunk_bytes=chunk_bytes)


def write_ros1(path: Path, stamps_ns: Stamps, positions: np.ndarray, topic: str = TOPIC) -> None:
    """The same in the encoding of ROS 1."""
    logs.write_ros1(path, poses(stamps_ns, positions, topic), start_ns=0)


def write_protobuf(
    path: Path, stamps_ns: Stamps, positions: np.ndarray, topic: str = TOPIC
) -> None:
    """The same as foxglove.PoseInFrame in protobuf."""

    def sent(stamp_ns: int, place: np.ndarray) -> tuple[str, int, object]:
        message = foxglove("PoseInFrame")(frame_id="map")
        message.timestamp.FromNanoseconds(stamp_ns)
        message.pose.position.x, message.pose.position.y, message.pose.position.z = place
        message.pose.orientation.w = 1
        return topic, stamp_ns, message

    logs.write_protobuf(path, map(sent, map(int, stamps_ns), positions))


def write_json(path: Path, stamps_ns: Stamps, positions: np.ndarray, topic: str = TOPIC) -> None:
    """The same as foxglove.PoseInFrame in JSON."""

    def sent(_topic: str, _kind: str, stamp_ns: int, fields: dict) -> Sent:
        at = {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}
        message = {"timestamp": at, "frame_id": "map", "pose": fields["pose"]}
        return topic, "foxglove.PoseInFrame", stamp_ns, message

    logs.write_json(path, (sent(*one) for one in poses(stamps_ns, positions, topic)), start_ns=0)


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
                channels[channel.id] = writer.register_channel(
                    channel.topic, "cdr", number, dict(channel.metadata)
                )
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
    packing = {"compression": compression, "chunk_bytes": chunk_bytes}
    logs.write_bag(path, poses(stamps_ns, positions, topic), start_ns=0, **packing)


def write_poses_folder(
    path: Path,
    stamps_ns: Stamps,
    positions: np.ndarray,
    topic: str = TOPIC,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    mode: CompressionMode = CompressionMode.NONE,
) -> Path:
    """The same as a ROS 2 bag's folder; gives the one file in it."""
    logs.write_folder(path, poses(stamps_ns, positions, topic), storage, mode, start_ns=0)
    return next(one for one in path.iterdir() if one.name != "metadata.yaml")
