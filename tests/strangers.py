"""Episodes and logs by others: made here with no code of the project."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

POSE = "geometry_msgs/msg/PoseStamped"


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


def write_poses(
    path: Path,
    stamps_ns: np.ndarray | list[int],
    positions: np.ndarray,
    topic: str = "/vrpn/thing/pose",
    compression: CompressionType = CompressionType.LZ4,
    set_header: bool = True,
) -> None:
    """A log of PoseStamped as a recorder of another distribution writes it."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start(profile="ros2", library="somebody's recorder")
        text = store.generate_msgdef(POSE, ros_version=2)[0].encode()
        schema = writer.register_schema(POSE, "ros2msg", text)
        channel = writer.register_channel(topic, "cdr", schema)
        for stamp, (x, y, z) in zip(stamps_ns, positions, strict=True):
            seconds, nanoseconds = divmod(int(stamp) if set_header else 0, 1_000_000_000)
            message = types[POSE](
                header=types["std_msgs/msg/Header"](
                    stamp=types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds),
                    frame_id="map",
                ),
                pose=types["geometry_msgs/msg/Pose"](
                    position=types["geometry_msgs/msg/Point"](x=float(x), y=float(y), z=float(z)),
                    orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
                ),
            )
            data = bytes(store.serialize_cdr(message, POSE))
            writer.add_message(channel, int(stamp), data, int(stamp))
        writer.finish()
