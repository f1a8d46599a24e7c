"""Measure reading speed: joint states from a log into arrays, here and by rosbags.

`python -m tests.bench.reading` writes 60,000 JointState messages of seven joints, reads them in
turns by both, and prints the ratio of the best times.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from tunenet_logs.reader import read_episode

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINTS = 7


def write_joints(path: Path, count: int) -> None:
    """Write a log of joint states at 1 kHz, by the libraries alone."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    rng = np.random.default_rng(0)
    with path.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start(profile="ros2")
        text = store.generate_msgdef(JOINT_STATE, ros_version=2)[0].encode()
        schema = writer.register_schema(JOINT_STATE, "ros2msg", text)
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for index in range(count):
            stamp_ns = 1_700_000_000_000_000_000 + index * 1_000_000
            stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
            message = types[JOINT_STATE](
                header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="base"),
                name=[f"joint{number}" for number in range(1, JOINTS + 1)],
                position=rng.normal(size=JOINTS),
                velocity=rng.normal(size=JOINTS),
                effort=rng.normal(size=JOINTS),
            )
            data = bytes(store.serialize_cdr(message, JOINT_STATE))
            writer.add_message(channel, stamp_ns, data, stamp_ns)
        writer.finish()


def theirs(path: Path) -> np.ndarray:
    """Read positions, velocities and efforts by rosbags' reader, shape (T, 21)."""
    stamps, rows = [], []
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            stamps.append(stamp.sec * 10**9 + stamp.nanosec)
            rows.append((message.position, message.velocity, message.effort))
    return np.array(rows).reshape(len(stamps), -1)


def ours(path: Path) -> np.ndarray:
    """Read the same by `read_episode`."""
    signals = read_episode(path).signals
    names = ("position", "velocity", "effort")
    return np.hstack([signals[f"/joint_states.{name}"].values for name in names])


def best(read: Callable[[Path], np.ndarray], path: Path) -> float:
    """Return the seconds of one reading."""
    start = time.perf_counter()
    read(path)
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60_000)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "joints.mcap"
        write_joints(path, arguments.count)
        assert np.array_equal(ours(path), theirs(path))
        rounds = [(best(theirs, path), best(ours, path)) for _ in range(arguments.rounds)]
    rosbags_s, ours_s = (min(times) for times in zip(*rounds, strict=True))
    print(f"rosbags {rosbags_s:.2f} s, here {ours_s:.2f} s for {arguments.count} messages")
    print(f"speed here / rosbags: {rosbags_s / ours_s:.2f}")


if __name__ == "__main__":
    main()
