"""Files that a stranger made to hurt, small and claiming much: what each of them may cost.

`HOSTILE` lists them by name; `spent` runs a command on one.
"""

from __future__ import annotations

import json
import resource
import sqlite3
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import lz4.frame
import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from tunenet_logs.messages import POSE, definition, encode, pose

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


class Hostile(NamedTuple):
    """A file, and what it may cost.

    Attributes:
        file: its name.
        make: gives its bytes, or writes to its path.
        is_quick: whether it is made and met in a moment.
        codes: with which `check` and `tune` may end; none where a command is not asked.
        says: what the commands say.
        cpu_s: of one command at most.
        peak_kib: likewise, memory.
    """

    file: str
    make: Callable[[Path], object]
    is_quick: bool = False
    codes: tuple[tuple[int, ...], tuple[int, ...]] = ((0, 1), (0, 1))
    says: str = ""
    cpu_s: float = 30.0  # three times what the slowest takes
    peak_kib: int = 500_000

    def write(self, folder: Path) -> Path:
        path = folder / self.file
        made = self.make(path)
        if isinstance(made, bytes):
            path.write_bytes(made)
        return path


# Records of MCAP and of bags.
MAGIC = b"\x89MCAP0\r\n"
HEADER = struct.pack("<BQII", 1, 8, 0, 0)
BAG = b"#ROSBAG V2.0\n"
_CHUNK_BYTES = 4 * 2**20
_DATA = encode(pose(0, "map", np.zeros(3)), POSE)


def mcap(*records: bytes) -> bytes:
    """A log without an end."""
    return b"".join((MAGIC, HEADER, *records))


def record(opcode: int, body: bytes = b"") -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(words: bytes) -> bytes:
    return struct.pack("<I", len(words)) + words


def chunk(compression: bytes, stated: int, data: bytes) -> bytes:
    """A chunk record without checksum."""
    body = struct.pack("<QQQI", 0, 1, stated, 0) + text(compression)
    return record(6, body + struct.pack("<Q", len(data)) + data)


def schema(number: int, kind: bytes, form: bytes, said: bytes) -> bytes:
    return record(3, struct.pack("<H", number) + text(kind) + text(form) + text(said))


def channel(number: int, schema_number: int, topic: bytes, encoding: bytes = b"cdr") -> bytes:
    head = struct.pack("<HH", number, schema_number)
    return record(4, head + text(topic) + text(encoding) + text(b""))


def described(count: int) -> bytes:
    """Schema and channels of poses, numbered from 0."""
    known = schema(1, POSE.encode(), b"ros2msg", definition(POSE).encode())
    return known + b"".join(channel(n, 1, b"/ch%d" % n) for n in range(count))


def message(channel_number: int = 0, data: bytes = b"", stamp_ns: int = 1) -> bytes:
    return record(5, struct.pack("<HIQQ", channel_number, 0, stamp_ns, stamp_ns) + data)


def packed_chunks(content: bytes, count: int = 256) -> bytes:
    """Chunks of 4 MiB of the same records."""
    plain = content * (_CHUNK_BYTES // len(content))
    return count * chunk(b"zstd", len(plain), zstandard.ZstdCompressor(19).compress(plain))


def zstd_of_zeros(mebibytes: int) -> bytes:
    packer = zstandard.ZstdCompressor(level=3).compressobj()
    parts = [packer.compress(bytes(2**24)) for _ in range(mebibytes // 16)]
    return b"".join([*parts, packer.flush()])


def bag_record(fields: dict[bytes, bytes], data: bytes = b"") -> bytes:
    return text(b"".join(text(name + b"=" + value) for name, value in fields.items())) + text(data)


def bag_connection(number: int) -> bytes:
    """A connection of poses."""
    more = text(b"type=geometry_msgs/PoseStamped") + text(b"md5sum=" + b"0" * 32)
    more += text(b"message_definition=float64 x")
    head = {b"op": b"\7", b"conn": struct.pack("<I", number), b"topic": b"/a%d" % number}
    return bag_record(head, more)


def db3_of(path: Path, topics: int, messages: int, data: bytes = b"") -> None:
    """A ROS 2 bag of sqlite3."""
    with closing(sqlite3.connect(path)) as base, base:
        columns = "id INTEGER PRIMARY KEY, name, type, serialization_format"
        base.execute(f"CREATE TABLE topics ({columns})")
        base.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        rows = ((n, f"/{n}", "geometry_msgs/msg/PoseStamped", "cdr") for n in range(topics))
        base.executemany("INSERT INTO topics VALUES (?, ?, ?, ?)", rows)
        said = ((n, n % topics, n, data) for n in range(messages))
        base.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", said)


def channels_of(count: int, kind: bytes, encoding: bytes, schemas: Sequence[bytes]) -> bytes:
    """Channels of one type, of these definitions in turns, packed."""
    form = b"protobuf" if encoding == b"protobuf" else b"ros2msg"
    made = [schema(n, kind, form, one) for n, one in enumerate(schemas, 1)]
    made += [channel(n, 1 + n % len(schemas), b"/%d" % n, encoding) for n in range(count)]
    pack = zstandard.ZstdCompressor(3).compress
    parts = [b"".join(made[at : at + 200]) for at in range(0, len(made), 200)]
    return mcap(*(chunk(b"zstd", len(part), pack(part)) for part in parts))


# Pictures.
_STORE = get_typestore(Stores.ROS2_HUMBLE)
_COMPRESSED = "sensor_msgs/msg/CompressedImage"


def blank(side_px: int) -> bytes:
    """A PNG, whole, of a few bytes once it is packed."""
    return cv2.imencode(".png", np.zeros((side_px, side_px), np.uint8))[1].tobytes()


def jpeg_of_scans(count: int, side_px: int = 4000) -> bytes:
    """A grey progressive JPEG whose scans are many and empty."""
    flags = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    data = cv2.imencode(".jpg", np.zeros((side_px, side_px), np.uint8), flags)[1].tobytes()
    at = data.rindex(b"\xff\xda")
    return data[:at] + data[at:-2] * count + b"\xff\xd9"


def png_of_words(count: int) -> bytes:
    """A PNG with parts of words that unpack to 7 MB each."""
    data = blank(1000)
    words = b"zTXt" + b"a\0\0" + zlib.compress(bytes(7_000_000), 9)
    part = struct.pack(">I", len(words) - 4) + words + struct.pack(">I", zlib.crc32(words))
    return data[:33] + part * count + data[33:]


def forged_jpeg(path: Path, claim: tuple[int, int] = (30_000, 30_000), tail: int = 0) -> None:
    """Small JPEGs whose headers claim another size; behind each, so many bytes that say nothing."""
    pixels = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    data = bytearray(cv2.imencode(".jpg", pixels)[1].tobytes())
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", *claim)
    defined = _STORE.generate_msgdef(_COMPRESSED, ros_version=2)[0]
    data += np.random.default_rng(1).bytes(tail)
    _log(path, _COMPRESSED, "ros2msg", defined, "cdr", _picture(0, "jpeg", bytes(data)))


def _picture(second: int, said: str, picture: bytes) -> bytes:
    types = _STORE.types
    stamp = types["builtin_interfaces/msg/Time"](sec=second, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    made = types[_COMPRESSED](header=header, format=said, data=np.frombuffer(picture, np.uint8))
    return bytes(_STORE.serialize_cdr(made, _COMPRESSED))


def write_pictures(
    path: Path, picture: bytes, count: int, topics: int = 1, others: int = 0
) -> None:
    """A log that holds one picture `count` times, in turns by topic, and `others` beside them."""
    defined = _STORE.generate_msgdef(_COMPRESSED, ros_version=2)[0]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        kind = writer.register_schema(_COMPRESSED, "ros2msg", defined.encode())
        channels = [writer.register_channel(f"/eye{n or ''}", "cdr", kind) for n in range(topics)]
        for index in range(1, count + 1):
            data = _picture(index, "png", picture)
            writer.add_message(channels[index % topics], index * 10**9, data, index * 10**9)
        other = writer.register_channel("/other", "none", 0) if others else 0
        for index in range(others):
            writer.add_message(other, index, b"", index)
        writer.finish()


def _log(path: Path, kind: str, form: str, said: str, encoding: str, data: bytes) -> None:
    """A message, two hundred times."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2")
        number = writer.register_schema(kind, form, said.encode())
        topic = writer.register_channel("/thing", encoding, number)
        for index in range(200):
            writer.add_message(topic, index * 10**7, data, index * 10**7)
        writer.finish()


# Logs whose bytes are not one expression.


def _chunk_in_chunk(_folder: Path) -> bytes:
    inner = b""
    for _ in range(1000):
        inner = chunk(b"", len(inner), inner)
    return mcap(inner)


def _huge_sequence(path: Path) -> None:
    kind = "sensor_msgs/msg/JointState"
    data = b"\x00\x01\x00\x00" + struct.pack("<iIII", 0, 0, 1, 0) + struct.pack("<I", 2**32 - 1)
    _log(path, kind, "ros2msg", _STORE.generate_msgdef(kind, ros_version=2)[0], "cdr", data)


def _nested_json(path: Path) -> None:
    deep = b"[" * 200_000
    _log(path, "foxglove.PoseInFrame", "jsonschema", deep.decode(), "json", b'{"pose":' + deep)


def _nested_metadata(path: Path) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        words = {"kind": json.dumps([[[]]]), "rig.drop_height_m": "nan", "truth.a": "1e999"}
        writer.add_metadata("tunenet/episode", {**words, "notes.x": "y" * 1_000_000})
        writer.finish()


def _many_small(_: Path) -> bytes:
    size = 120 * 2**20
    packed = zstandard.ZstdCompressor(level=3).compress(record(0x80, bytes(size - 9)))
    return mcap(300 * chunk(b"zstd", size, packed))


def _ended(*records: bytes) -> bytes:
    return mcap(*records, record(2, bytes(20)), MAGIC)


def _many_types(_: Path) -> bytes:
    made = ((schema(n, b"a/msg/T%d" % n, b"ros2msg", b"float64[3] position\n"),
             channel(n, n, b"/%d" % n)) for n in range(1, 65_000))  # fmt: skip
    return mcap(*(one for both in made for one in both))


def _unclosed_texts(_: Path) -> bytes:
    said = b"struct position {\n" + b'"\\' * 30_000
    made = (schema(n, b"a/msg/T", b"ros2idl", said) + channel(n, n, b"/%d" % n)
            + message(n, bytes(64)) for n in range(1, 31))  # fmt: skip
    return mcap(*made)


def _protobuf_channels(_: Path) -> bytes:
    from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
    from mcap_protobuf.schema import build_file_descriptor_set

    files: Any = build_file_descriptor_set(PoseInFrame)
    more = files.file.add(name="more.proto", package="more", syntax="proto3")
    for n in range(20_000):
        more.message_type.add(name=f"M{n}").field.add(name="x", number=1, type=1, label=1)
    return channels_of(9_000, b"foxglove.PoseInFrame", b"protobuf", [files.SerializeToString()])


def _long_definitions(_: Path) -> bytes:
    usual = definition(POSE).encode()
    schemas = [usual + b"\n# %d" % n + b"\nfloat64 x" * 20_000 for n in range(3_000)]
    return channels_of(3_000, POSE.encode(), b"cdr", schemas)


def _tiny_messages_in_a_bag(_: Path) -> bytes:
    one = bag_record({b"op": b"\2", b"conn": bytes(4), b"time": bytes(8)})
    plain = one * (_CHUNK_BYTES // len(one))
    head = {b"op": b"\5", b"compression": b"lz4", b"size": struct.pack("<I", len(plain))}
    made = bag_record(head, lz4.frame.compress(plain, compression_level=9))
    return BAG + bag_connection(0) + made * 256


def _still_film(path: Path) -> None:
    import av

    with av.open(str(path), "w", format="mp4") as film:
        stream: Any = film.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 4000, 4000, "yuv420p"
        stream.options = {"preset": "ultrafast", "crf": "40"}
        stream.gop_size = 1000
        picture = av.VideoFrame.from_ndarray(np.zeros((4000, 4000, 3), np.uint8), format="rgb24")
        for picture.pts in range(150):
            film.mux(stream.encode(picture))
        film.mux(stream.encode())


_FALSE = struct.pack("<BQQQQII", 6, 40, 0, 1, 0, 0, 4) + b"zstd"
_FAR = struct.pack("<BQQQQII", 6, 2**60, 0, 1, 0, 0, 4) + b"zstd"
LONG_METADATA = mcap(record(12, text(b"a") + text(bytes(40_000_000))))
_COUNTED = struct.pack("<QHIIIIQQ", *[0] * 8) + text(bytes(40_000_000))

_REFUSED = ((1,), (1,))
_NO_LOGS: dict[str, Callable[[Path], object]] = {
    "zstd_of_4_gib": lambda _: mcap(chunk(b"zstd", 4 * 2**30, zstd_of_zeros(4096))),
    "zstd_that_states_little": lambda _: mcap(chunk(b"zstd", 1000, zstd_of_zeros(4096))),
    "many_small_bombs": _many_small,  # 300 chunks of 4 kB that unpack to 120 MiB each
    "chunk_in_chunk": _chunk_in_chunk,  # a thousand, one in the other
    "huge_length": lambda _: mcap(struct.pack("<BQ", 5, 2**62), bytes(50)),
    "huge_sequence": _huge_sequence,  # joint states that claim 2^32 - 1 names
    "nested_json": _nested_json,  # 200,000 brackets in a message, and in a schema
    "forged_jpeg": forged_jpeg,
    "forged_jpeg_within_bounds": lambda path: forged_jpeg(path, (5900, 6000)),
    "blank_pictures": lambda path: write_pictures(path, blank(6000), 60),
}
_QUICK_LOGS: dict[str, Callable[[Path], object]] = {
    "zeros_in_chunks": lambda _: mcap(described(1), packed_chunks(b"\0"), bytes(1_000_000)),
    "tiny_records_in_chunks": lambda _: mcap(described(1), packed_chunks(record(0x80))),
    "zeros_behind_the_magic": lambda _: MAGIC + bytes(30_000_000),  # what a power cut leaves
    "damaged_records": lambda _: mcap(record(3) * 3_300_000),
    "many_types": _many_types,
    "false_chunks": lambda _: mcap((_FALSE + b"\xff" * 40) * 100_000),
    "many_scans": lambda path: write_pictures(path, jpeg_of_scans(3000), count=3),
    "packed_words_png": lambda path: write_pictures(path, png_of_words(900), count=10),
    "unclosed_texts": _unclosed_texts,
    "protobuf_channels": _protobuf_channels,  # 9,000 of one definition of a megabyte
}
_LOGS: dict[str, Callable[[Path], object]] = {
    "tiny_messages_in_chunks": lambda _: mcap(described(1), packed_chunks(message())),
    "poses_in_chunks": lambda _: mcap(described(1), packed_chunks(message(0, _DATA))),
    "unknown_messages_in_chunks": lambda _: mcap(packed_chunks(message(7))),
    "channels_in_chunks": lambda _: mcap(packed_chunks(described(1))),  # one, again and again
    "zeros_between": lambda _: mcap((bytes(10) + record(0x80)) * 2_000_000),
    "private_records": lambda _: mcap(record(0x80) * 4_600_000),
    "empty_metadata": lambda _: mcap(record(12, bytes(8)) * 2_500_000),
    "long_metadata": lambda _: LONG_METADATA,  # five million empty words
    "long_statistics": lambda _: _ended(record(15, bytes(4)), record(11, _COUNTED)),
    "many_channels": lambda _: _ended(described(65_000), record(15, bytes(4))),
    "many_heard_channels": lambda _: mcap(
        described(9_900), *(message(n, _DATA, 1 + k) for k in range(3) for n in range(9_900))
    ),
    "many_chunks_of_channels": lambda _: mcap(
        described(9_900), chunk(b"", 9, record(0x80)) * 100_000
    ),
    "impossible_chunks": lambda _: mcap(_FAR * 300_000),
    "picture_topics": lambda path: write_pictures(path, blank(64), 2000, 2000, 300_000),
    "small_blank_log": lambda path: write_pictures(path, blank(4000), 40),  # of 28 kB
    "long_definitions": _long_definitions,  # 3,000 of 200 kB each, in 3,000 channels
    "bag_of_tiny_messages": _tiny_messages_in_a_bag,
    "bag_of_connections": lambda _: BAG + b"".join(map(bag_connection, range(200_000))),
    "bag_of_zeros": lambda _: BAG + bytes(30_000_000),
    "bag_of_marks": lambda _: BAG + b"\x04\0\0\0op=" * 2_000_000,
    "bag_of_damage": lambda _: BAG + (bag_record({b"op": b"\x09"}) + b"\xff" * 4) * 500_000,
    "db3_of_topics": lambda path: db3_of(path, 1_000_000, 1),
    "db3_of_empty_messages": lambda path: db3_of(path, 1, 2_000_000),
    "still_film": _still_film,  # 150 pictures of 16 megapixels in 53 kB
    "believed_jpeg": lambda path: forged_jpeg(path, (6000, 6000), tail=70_000),
}
HOSTILE: dict[str, Hostile] = {
    **{name: Hostile("bomb.mcap", make, True, _REFUSED) for name, make in _NO_LOGS.items()},
    "nested_metadata": Hostile("bomb.mcap", _nested_metadata, True, ((0,), (1,))),
    **{name: Hostile("bomb.mcap", make, True) for name, make in _QUICK_LOGS.items()},
    **{name: Hostile("bomb.mcap", make) for name, make in _LOGS.items()},
    "empty_lines": Hostile("bomb.csv", lambda _: b"t,z\n0,1\n" + b"\n" * 20_000_000 + b"1,1\n"),
}
