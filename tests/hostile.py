"""Files that a stranger made to hurt: small, and claiming much."""

from __future__ import annotations

import json
import resource
import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

# A small process between: the peak of one that is forked counts its parent's memory too. What hangs
# is ended by its CPU time.
LAUNCHER = """
import resource, subprocess, sys
resource.setrlimit(resource.RLIMIT_CPU, (300, 300))
code = subprocess.run(sys.argv[1:]).returncode
sys.stdout.flush()
print("peak", resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, file=sys.stderr)
sys.exit(code)
"""


class Spent(NamedTuple):
    """What a command said, its exit code, and what it cost."""

    said: str
    code: int
    cpu_s: float
    peak_kib: int


def spent(command: Sequence[str], folder: Path) -> Spent:
    """Run a command in a folder."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    line = [sys.executable, "-c", LAUNCHER, *command]
    done = subprocess.run(line, check=False, cwd=folder, capture_output=True, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    said, _, peak = (done.stdout + done.stderr).rpartition("peak ")
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Spent(said, done.returncode, cpu_s, int(peak))


MAGIC = b"\x89MCAP0\r\n"
HEADER = struct.pack("<BQII", 1, 8, 0, 0)


def chunk(compression: bytes, stated: int, data: bytes) -> bytes:
    """A chunk record without checksum."""
    body = struct.pack("<QQQII", 0, 1, stated, 0, len(compression)) + compression
    body += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


def zstd_of_4_gib(path: Path) -> None:
    """131 kB that unpack to 4 GiB."""
    packer = zstandard.ZstdCompressor(level=3).compressobj()
    block = bytes(16 * 2**20)
    packed = b"".join([*(packer.compress(block) for _ in range(256)), packer.flush()])
    path.write_bytes(MAGIC + HEADER + chunk(b"zstd", 4 * 2**30, packed))


def zstd_that_states_little(path: Path) -> None:
    """The same, stated as a thousand bytes."""
    packer = zstandard.ZstdCompressor(level=3).compressobj()
    packed = b"".join([*(packer.compress(bytes(2**24)) for _ in range(256)), packer.flush()])
    path.write_bytes(MAGIC + HEADER + chunk(b"zstd", 1000, packed))


def many_small_bombs(path: Path) -> None:
    """300 chunks of 4 kB that unpack to 120 MiB each."""
    size = 120 * 2**20
    record = struct.pack("<BQ", 0x80, size - 9) + bytes(size - 9)  # a record to be skipped
    packed = zstandard.ZstdCompressor(level=3).compress(record)
    path.write_bytes(MAGIC + HEADER + 300 * chunk(b"zstd", size, packed))


def chunk_in_chunk(path: Path) -> None:
    """A thousand chunks, one in the other."""
    inner = b""
    for _ in range(1000):
        inner = chunk(b"", len(inner), inner)
    path.write_bytes(MAGIC + HEADER + inner)


def huge_length(path: Path) -> None:
    """A record of 2^62 bytes."""
    path.write_bytes(MAGIC + HEADER + struct.pack("<BQ", 5, 2**62) + bytes(50))


def huge_sequence(path: Path) -> None:
    """Joint states that claim 2^32 - 1 names, and as many positions."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    data = b"\x00\x01\x00\x00" + struct.pack("<iIII", 0, 0, 1, 0) + struct.pack("<I", 2**32 - 1)
    _log(path, kind, "ros2msg", store.generate_msgdef(kind, ros_version=2)[0], "cdr", data)


def nested_json(path: Path) -> None:
    """200,000 brackets in a message, and in a schema."""
    deep = b"[" * 200_000
    _log(path, "foxglove.PoseInFrame", "jsonschema", deep.decode(), "json", b'{"pose":' + deep)


def forged_jpeg(path: Path, claim: tuple[int, int] = (30_000, 30_000)) -> None:
    """Small JPEGs whose headers claim another size."""
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    data = bytearray(cv2.imencode(".jpg", pixels)[1].tobytes())
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", *claim)
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/CompressedImage"
    types = store.types
    header = types["std_msgs/msg/Header"](
        stamp=types["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id=""
    )
    message = types[kind](header=header, format="jpeg", data=np.frombuffer(bytes(data), np.uint8))
    text = store.generate_msgdef(kind, ros_version=2)[0]
    _log(path, kind, "ros2msg", text, "cdr", bytes(store.serialize_cdr(message, kind)))


def forged_jpeg_within_bounds(path: Path) -> None:
    """The same, claiming no more than a large camera has."""
    forged_jpeg(path, (5900, 6000))


def blank_pictures(path: Path) -> None:
    """PNGs of 36 megapixels that are blank: whole, and a few bytes each once they are packed."""
    write_pictures(path, cv2.imencode(".png", np.zeros((6000, 6000), np.uint8))[1].tobytes(), 60)


def write_pictures(
    path: Path, picture: bytes, count: int, topics: int = 1, others: int = 0
) -> None:
    """A log that holds one picture `count` times, in turns by topic, and `others` beside them."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/CompressedImage"
    types = store.types
    text = store.generate_msgdef(kind, ros_version=2)[0]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(kind, "ros2msg", text.encode())
        channels = [writer.register_channel(f"/eye{n or ''}", "cdr", schema) for n in range(topics)]
        for index in range(1, count + 1):
            stamp = types["builtin_interfaces/msg/Time"](sec=index, nanosec=0)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            pixels = np.frombuffer(picture, np.uint8)
            message = types[kind](header=header, format="png", data=pixels)
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(channels[index % topics], index * 10**9, data, index * 10**9)
        other = writer.register_channel("/other", "none", 0) if others else 0
        for index in range(others):
            writer.add_message(other, index, b"", index)
        writer.finish()


def nested_metadata(path: Path) -> None:
    """An episode record of a million characters and of numbers that are none."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        words = {"kind": json.dumps([[[]]]), "rig.drop_height_m": "nan", "truth.a": "1e999"}
        writer.add_metadata("tunenet/episode", {**words, "notes.x": "y" * 1_000_000})
        writer.finish()


BOMBS: tuple[Callable[[Path], None], ...] = (
    zstd_of_4_gib,
    zstd_that_states_little,
    many_small_bombs,
    chunk_in_chunk,
    huge_length,
    huge_sequence,
    nested_json,
    forged_jpeg,
    forged_jpeg_within_bounds,
    blank_pictures,
    nested_metadata,
)


def _log(path: Path, kind: str, schema: str, text: str, encoding: str, data: bytes) -> None:
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2")
        number = writer.register_schema(kind, schema, text.encode())
        channel = writer.register_channel("/thing", encoding, number)
        for index in range(200):
            writer.add_message(channel, index * 10**7, data, index * 10**7)
        writer.finish()
